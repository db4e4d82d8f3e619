"""Frames as files: animations, videos, strips."""

import subprocess
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image

from humanoid_mjx.files import refusing, whole_file
from humanoid_mjx.report.raycast import Frame
from humanoid_mjx.spec import InputError, check_folder

ENDINGS = (".gif", ".mp4", ".webm", ".png")

CODECS = {
    ".mp4": ("-pix_fmt", "yuv420p", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-pix_fmt", "yuv420p", "-crf", "32", "-b:v", "0", "-cpu-used", "5"),
}
"""Options of ffmpeg for videos that browsers play."""


def check_file(path: Path) -> None:
    """Check, before any work, that a file of this name can be made.

    Raises:
      InputError: its ending is none of `ENDINGS`, there is no such folder, or its kind needs a package that is missing.
    """
    if path.suffix not in ENDINGS:
        raise InputError(f"{path}: the file must end in .gif, .mp4, .webm or .png.")
    check_folder(path)
    if path.suffix in CODECS and find_spec("imageio_ffmpeg") is None:
        raise InputError(
            f"{path}: {path.suffix} needs the package imageio-ffmpeg: pip install 'humanoid-mjx[video]' brings it; "
            ".gif needs nothing."
        )


def write_frames(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Write frames into the file that `check_file` has passed: .png side by side, the others one after another.

    Raises:
      InputError: the file cannot be written.
    """
    with refusing(path), whole_file(path) as temporary:
        if path.suffix == ".png":
            Image.fromarray(np.concatenate(list(frames), axis=1)).save(temporary)
        elif path.suffix == ".gif":
            first, *rest = map(Image.fromarray, frames)
            first.save(temporary, save_all=True, append_images=rest, duration=1000 / fps, loop=0)
        else:
            _encode(frames, temporary, fps)


def _encode(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Let ffmpeg make a video."""
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    rest = iter(frames)
    first = next(rest)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *CODECS[path.suffix], str(path)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process:
            for frame in chain([first], rest):
                process.stdin.write(frame.tobytes())
        if process.returncode:
            errors.seek(0)
            words = " ".join(errors.read().decode(errors="replace").split())
            raise InputError(f"{path}: ffmpeg could not write it: {words[-300:]}.")
