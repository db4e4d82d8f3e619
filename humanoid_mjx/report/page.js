// Tables that sort by a column, and figures that say what their lines are below the pointer.
"use strict";
(() => {
  const number = (text) => parseFloat(text.replace(/,/g, ""));
  document.querySelectorAll("table").forEach((table) => {
    const body = table.tBodies[0];
    if (!body || body.rows.length < 3) return;
    [...table.tHead.rows[0].cells].forEach((heading, column) => {
      const button = document.createElement("button");
      button.append(...heading.childNodes);
      heading.append(button);
      button.onclick = () => {
        const up = heading.getAttribute("aria-sort") !== "ascending";
        for (const each of table.tHead.rows[0].cells) each.removeAttribute("aria-sort");
        heading.setAttribute("aria-sort", up ? "ascending" : "descending");
        const key = (row) => row.cells[column].textContent;
        const compare = (a, b) => number(key(a)) - number(key(b)) || key(a).localeCompare(key(b));
        body.append(...[...body.rows].sort((a, b) => (up ? compare(a, b) : compare(b, a))));
      };
    });
  });

  document.querySelectorAll("figure[data-lines]").forEach((figure) => {
    const { box: [left, top, right, bottom], x: [low, high], scale, lines } = JSON.parse(figure.dataset.lines);
    const image = figure.querySelector("img"), tip = document.createElement("div"), mark = document.createElement("div");
    tip.className = "tip";
    mark.className = "mark";
    const log = scale === "log", away = (x) => (log ? Math.log(x) : x);
    const hide = () => { tip.remove(); mark.remove(); };
    image.addEventListener("pointermove", (event) => {
      const place = image.getBoundingClientRect(), base = figure.getBoundingClientRect();
      const share = ((event.clientX - place.left) / place.width - left) / (right - left);
      if (share < 0 || share > 1) return hide();
      const x = away(low) + share * (away(high) - away(low));
      const found = Object.entries(lines).map(([label, [xs, ys]]) => {
        let nearest = 0;
        xs.forEach((each, i) => { if (Math.abs(away(each) - x) < Math.abs(away(xs[nearest]) - x)) nearest = i; });
        return [label, xs[nearest], ys[nearest]];
      });
      const at = found[0][1], along = left + ((away(at) - away(low)) / (away(high) - away(low))) * (right - left);
      tip.textContent = [`at ${at.toLocaleString("en")}`,
        ...found.map(([label, , value]) => `${label}: ${value.toLocaleString("en", { maximumSignificantDigits: 4 })}`)].join("\n");
      figure.append(mark, tip);
      Object.assign(mark.style, { left: `${place.left - base.left + along * place.width}px`,
        top: `${place.top - base.top + top * place.height}px`, height: `${(bottom - top) * place.height}px` });
      const before = along > 0.5 ? tip.offsetWidth + 16 : -8;
      Object.assign(tip.style, { left: `${place.left - base.left + along * place.width - before}px`,
        top: `${place.top - base.top + top * place.height}px` });
    });
    image.addEventListener("pointerleave", hide);
  });
})();
