"""A flight as an animation that README files and chats show: GIF, WebP or MP4."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from tqdm import tqdm

from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.files import write_whole
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.plots import palette
from vpptwin.viz.plots.figure import thin
from vpptwin.viz.scene.frames import Painter
from vpptwin.viz.scene.show import TRAIL_DURATION, Show, prepare_show, view_show

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight

MP4 = ".mp4"
FORMATS = (".gif", ".webp", MP4)
RATE = 25.0  # frames a second; a GIF's frames last multiples of 10 ms
MAX_LOOP_S = 120.0  # s; longer ones are not what anybody loads, other than as MP4
MARGIN, SMALLEST_HALF_HEIGHT = 0.4, 0.55  # m; nearer than a page, which can be turned and zoomed


def check_video(out: Path) -> None:
    """Refuse what is no animation's name."""
    if out.suffix.lower() not in FORMATS:
        expected = f"a name that ends in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        raise InputError(f"--video {out}", expected, "e.g. --video flip.gif")
    if out.suffix.lower() == MP4:
        load_extra("imageio_ffmpeg", f"--video {out}")


def write_video(
    flight: Flight, prediction: Prediction | None, out: Path, *, spec: TwinSpec, size: tuple[int, int] = (640, 400)
) -> Path:
    """Write a flight, and the twin beside it, as an animation in real time that repeats.

    Args:
        flight: the log.
        prediction: the twin's answer to the log's commands, drawn translucent; None for the log alone.
        out: .gif, .webp, or .mp4, which does not repeat by itself.
        spec: the twin whose rig is drawn.
        size: of a frame, width and height in pixels.

    Raises:
        InputError: if the log has nothing to draw or is too long, or the file cannot be written.
    """
    check_video(out)
    show = prepare_show(flight, prediction, spec)
    film = out.suffix.lower() == MP4
    if show.time[-1] > MAX_LOOP_S and not film:
        found = f"{flight.path}: {show.time[-1]:.0f} s"
        raise InputError(found, f"at most {MAX_LOOP_S:.0f} s for an animation", "cut the log, or use --html, or .mp4")
    view = view_show(show, margin=MARGIN, smallest=SMALLEST_HALF_HEIGHT, aspect=size[0] / size[1])
    painter = Painter(show.model, view, size)
    times = np.arange(0.0, show.time[-1], 1.0 / RATE)
    bar = tqdm(paint_show(painter, show, times), total=len(times), leave=False, disable=None, desc="video")
    if film:
        return write_whole(out, encode_film(bar, size))
    frames = [Image.fromarray(frame) for frame in bar]
    content = io.BytesIO()
    options: dict[str, object] = {"save_all": True, "duration": round(1000 / RATE), "loop": 0}
    if out.suffix.lower() == ".gif":
        # One palette for all frames: else colours flicker, and unchanged pixels cost again.
        colours = choose_palette(frames)
        frames = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
        options |= {"optimize": True, "comment": b"vpptwin"}
    else:
        options["xmp"] = b"vpptwin"
    frames[0].save(content, format=out.suffix[1:].upper(), append_images=frames[1:], **options)
    return write_whole(out, content.getvalue())


def encode_film(frames: Iterable[np.ndarray], size: tuple[int, int]) -> bytes:
    """Frames (height, width, 3) as MP4 that every browser and chat plays: H.264."""
    ffmpeg = load_extra("imageio_ffmpeg", "an MP4")
    # Width and height even, colours at half the resolution, what a player needs first at the beginning.
    options = ["-movflags", "+faststart", "-metadata", "comment=vpptwin"]
    with tempfile.TemporaryDirectory(prefix="vpptwin-") as folder:
        film = Path(folder) / "film.mp4"
        try:
            writer = ffmpeg.write_frames(
                str(film), size, fps=RATE, codec="libx264", pix_fmt_out="yuv420p", macro_block_size=2, quality=8,
                output_params=options,
            )  # fmt: skip
            with closing(writer):
                writer.send(None)
                for frame in frames:
                    writer.send(np.ascontiguousarray(frame))
            return film.read_bytes()
        except (OSError, RuntimeError) as error:
            told = str(error).strip().splitlines() or ["it does not say why"]
            found = f"ffmpeg does not write MP4: {told[-1]}"
            advice = "pip install --force-reinstall imageio-ffmpeg, or write .webp"
            raise InputError(found, "that of imageio-ffmpeg, or one with libx264", advice) from error


def choose_palette(frames: Sequence[Image.Image]) -> Image.Image:
    """The colours of a few frames from first to last, and those that have a meaning."""
    some = [frames[i] for i in thin(len(frames), 12)]
    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some) + 40))
    for row, frame in enumerate(some):
        sheet.paste(frame, (0, row * frame.height))
    colours = (palette.POSITIVE_THRUST, palette.NEGATIVE_THRUST, palette.TWIN, palette.TARGET, palette.TOP_MARK)
    width = sheet.width // len(colours)
    for i, colour in enumerate(colours):
        sheet.paste(colour, (i * width, sheet.height - 40, (i + 1) * width, sheet.height))
    return sheet.quantize(160, Image.Quantize.MAXCOVERAGE)


def paint_show(painter: Painter, show: Show, times: np.ndarray) -> Iterator[np.ndarray]:
    """Frames of a show at times (k,) [s] from its start."""
    nearest = np.searchsorted(show.time, times).clip(0, len(show.time) - 1)
    for time, row in zip(times, nearest):
        twin = None if show.twin is None or not show.twin.shown[row] else show.twin.qpos[row]
        past = show.log.qpos[(show.time > time - TRAIL_DURATION) & (show.time <= time)]
        trail, text = past[:, :2] if show.followed >= 0 else None, [f"{time + show.frames[0]:5.2f} s"]
        yield painter.draw(show.log.qpos[row], twin=twin, trail=trail, text=text, overlay=show.overlay, time=time)
