"""Draw the public robots whose YAMLs ship, at home on the ground: `python experiments/robots_picture.py` writes
docs/robots.png. It needs the packages of docs/robots.md; capsules from joint to joint stand for meshes that they lack.
"""

import copy
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from humanoid_mjx.files import folder, names
from humanoid_mjx.report.rendering import draw
from humanoid_mjx.robot import make_robot

COLUMNS, SIZE, ROOM = 4, (300, 225), 1.3
"""Robots in a row, size of each picture, pixels, and a factor on the extent that has room there."""


def picture(name: str) -> Image.Image:
    """A robot, and its name."""
    robot = make_robot(name)
    posture = robot.model.qpos0.copy()
    posture[2], posture[robot.model.jnt_qposadr[robot.driven]] = robot.start_height, robot.posture
    model = copy.copy(robot.model)
    model.stat.extent = ROOM * max(model.stat.extent, 1.3 * np.ptp(robot.soles, axis=0).max())
    (frame,) = draw(model, posture[None])
    image = Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS)
    ImageDraw.Draw(image).text((8, 6), name, fill="black", font_size=15)
    return image


def main() -> None:
    texts = {name: (folder("robots") / f"{name}.yaml").read_text() for name in names("robots", ".yaml")}
    public = [name for name, text in texts.items() if "package:" in text]
    pictures = np.stack([np.asarray(picture(name)) for name in public])
    rows = [np.concatenate(list(pictures[i : i + COLUMNS]), axis=1) for i in range(0, len(pictures), COLUMNS)]
    Image.fromarray(np.concatenate(rows)).quantize(128).save(Path(__file__).parent.parent / "docs" / "robots.png")


if __name__ == "__main__":
    main()
