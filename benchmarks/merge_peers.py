"""One bracket, merged by us and by peers: the error against truth, and the CPU time it took.

Two kinds of work are kept apart. From arrays: the exposures are in memory as each wants them, and
only merging is timed. From files: DNGs, lossless JPEG, to one merged image, decoding included.

Every peer does what it is meant for as well as it can: what its settings are is said where it is
called, each the best found. Error is relative to the truth, after the one factor per CFA position
that fits best (the median), over all pixels: its root mean square, which what goes wrong rules,
and its median, which noise rules. Demosaicing is not judged; values are taken at the samples' own
places.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import spent
from benchmarks.figure import Figure
from pipeline.bracket import Bracket
from pipeline.simulate.camera import Camera
from pipeline.simulate.dng import Shot, write_dng
from stages.bracket import workers
from stages.demosaic import demosaic
from stages.merge import InMemory, merge
from stages.types import Frame

OURS = "sixlight"
PLACES = ((0, 0), (0, 1), (1, 0), (1, 1))  # of the CFA
ISO, F_NUMBER = 100, 16.0


@dataclass(frozen=True)
class Shots:
    """One bracket, in memory and in files.

    frames  raw samples; their times are the tags
    files   the same as DNGs
    world   (H, W) the truth, full scale per second
    """

    frames: list[Frame]
    files: list[Path]
    world: NDArray[np.float64]

    @property
    def times_s(self) -> list[float]:
        return [frame.time_s for frame in self.frames]

    @property
    def linear(self) -> list[NDArray[np.float32]]:
        """Samples in full scale (H, W) as anyone develops them, clipped to 0..1."""
        return [_developed(frame.samples, frame) for frame in self.frames]

    @property
    def bracket(self) -> Bracket:
        given = [{"time_s": t, "iso": ISO, "f_number": F_NUMBER} for t in self.times_s]
        return Bracket(self.files, given, self.files[0].parent)


def photographed(frames: list[Frame], world, folder: Path, name: str) -> Shots:
    """The frames, RGGB, written to a folder too."""
    first = frames[0]
    height, width = first.samples.shape
    camera = Camera(
        width=width,
        height=height,
        f_number=F_NUMBER,
        iso=ISO,
        black_level=int(first.black_level[0, 0]),
        saturation_level=int(first.saturation_level[0, 0]),
    )
    # Of no consequence to the samples, but converters refuse a camera of which they know no colour.
    colour_matrix = np.array([[0.9, -0.2, -0.1], [-0.4, 1.2, 0.2], [0.0, 0.2, 0.6]])
    files = []
    for i, frame in enumerate(frames):
        files.append(folder / f"{name}_{i}.dng")
        shot = Shot((1, round(1 / frame.time_s)), datetime(2020, 1, 1), (1.0, 1.0, 1.0))
        write_dng(files[-1], frame.samples, camera, shot, colour_matrix)
    return Shots(frames, files, world)


def compared(true: Shots, astray: Shots) -> Iterator[Figure]:
    """The table.

    true    the shutter keeps to its tags
    astray  it does not: what becomes of those who trust the tags
    """
    os.environ["TQDM_DISABLE"] = "1"  # progress bars of peers; read when tqdm is first imported
    for kind, runs in (("arrays", _of_arrays(true)), ("files", _of_files(true))):
        rows = _judged(kind, runs, true.world)
        for name, row in rows.items():
            yield Figure(f"{kind}, {name}: error, rms", row.rms, "%")
            yield Figure(f"{kind}, {name}: error, median", row.median, "%")
            yield Figure(f"{kind}, {name}: CPU", row.cpu_s, "s")
        yield from _ours_beside(kind, rows)
    yield Figure("files, decoded by rawpy and no more: CPU", _cpu(lambda: _decoded(true))[1], "s")
    runs = _of_files(astray, solve=True)
    for name, row in _judged("tags astray", runs, astray.world).items():
        yield Figure(f"tags astray, {name}: error, rms", row.rms, "%")


@dataclass(frozen=True)
class _Row:
    rms: float
    median: float
    cpu_s: float


Run = Callable[[], NDArray]


def _ours_beside(kind: str, rows: dict[str, _Row]) -> Iterator[Figure]:
    """Whether any peer has a smaller error, and how many times our CPU they take.

    The first row of ours is held against them: a merged mosaic, which others give too.
    """
    mine = next(row for name, row in rows.items() if name.startswith(OURS))
    others = [row for name, row in rows.items() if not name.startswith(OURS)]
    if not others:
        return
    for what in ("rms", "median"):
        best = min(getattr(row, what) for row in others)
        name = f"{kind}, {what} error over the best peer's"
        yield Figure(name, getattr(mine, what) / best, "times", high=1.0)
    fastest = min(row.cpu_s for row in others)
    yield Figure(f"{kind}, CPU of the fastest peer over ours", fastest / mine.cpu_s, "times", low=3)
    truest = min(others, key=lambda row: row.rms).cpu_s
    yield Figure(f"{kind}, CPU of the most exact peer over ours", truest / mine.cpu_s, "times")


def _judged(kind: str, runs: dict[str, Run | str], world) -> dict[str, _Row]:
    """Each run and judged; of what is not to be had it is said why."""
    rows = {}
    for name, run in runs.items():
        if isinstance(run, str):
            print(f"{kind}, {name}: not to be had here: {run}")
            continue
        try:
            values, cpu_s = _cpu(run)
        except Exception as error:
            if name.startswith(OURS):
                raise
            # Whatever a peer of some other version does must not take the other rows with it.
            print(f"{kind}, {name}: failed: {type(error).__name__}: {error}"[:300])
            continue
        off = _relative_error(values, world)
        rms, median = np.sqrt(np.mean(off**2)), np.median(np.abs(off))
        rows[name] = _Row(100 * float(rms), 100 * float(median), cpu_s)
    return rows


def _relative_error(values, world) -> NDArray[np.float64]:
    """(H, W); what is no number is as wrong as nothing at all: -1."""
    ratio = values.reshape(world.shape) / world
    for row, column in PLACES:
        ratio[row::2, column::2] /= np.nanmedian(ratio[row::2, column::2])
    return np.where(np.isfinite(ratio), ratio, 0.0) - 1.0


def _cpu(run: Run) -> tuple[NDArray, float]:
    """What it gives, and CPU seconds of all its threads and of programs it ran."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # peers' own, of values that are no colours
        before = spent.cpu_s()
        values = run()
        return values, spent.cpu_s() - before


# ------------------------------------------------------------------------------- from arrays


def _of_arrays(shots: Shots) -> dict[str, Run | str]:
    # Three channels are wanted: three samples of a row make a pixel, so that as many numbers are
    # merged as we merge.
    size = shots.world.shape[0], -1, 3
    linear = [values.reshape(size) for values in shots.linear]
    return {
        OURS: lambda: merge(InMemory(shots.frames)).mosaic,
        "colour-hdri": _colour_hdri(linear, shots.times_s),
        **_opencv(linear, shots.times_s),
    }


def _colour_hdri(linear, times_s) -> Run | str:
    """Weighted as Debevec and Malik 1997 do, its default."""
    if not find_spec("colour_hdri"):
        return "pip install 'sixlight[bench]'"
    import colour_hdri

    def run():
        images = colour_hdri.ImageStack()
        for data, time_s in zip(linear, times_s, strict=True):
            metadata = colour_hdri.Metadata(f_number=1.0, exposure_time=time_s, iso=ISO)
            images.append(colour_hdri.Image(data=data, metadata=metadata))
        return colour_hdri.image_stack_to_HDRI(images, colour_hdri.weighting_function_Debevec1997)

    return run


def _opencv(linear, times_s) -> dict[str, Run | str]:
    """It takes 8 bits, and a response. MergeDebevec errs least where the response is a square, as
    photon noise wants it; MergeRobertson, which weighs by the response, where it is straight."""
    import cv2

    exact_s = np.array(times_s, np.float32)
    runs: dict[str, Run | str] = {}
    for name, create, power in (
        ("OpenCV MergeDebevec, 8 bit", cv2.createMergeDebevec, 2.0),
        ("OpenCV MergeRobertson, 8 bit", cv2.createMergeRobertson, 1.0),
    ):
        encoded = [np.rint(v ** (1 / power) * 255).astype(np.uint8) for v in linear]
        codes = np.maximum(np.arange(256, dtype=np.float32), 0.5) / 255  # the logarithm is taken
        response = (codes**power)[:, None, None].repeat(3, axis=2)
        runs[name] = lambda c=create, e=encoded, r=response: c().process(e, exact_s, r)
    return runs


# -------------------------------------------------------------------------------- from files


def _of_files(shots: Shots, *, solve: bool = False) -> dict[str, Run | str]:
    """solve  let HDRutils estimate the exposures, which takes most of its time"""

    def ours_demosaiced():
        merged = merge(shots.bracket)
        demosaic(merged)
        return merged.mosaic

    def after(merge_arrays):
        return lambda: merge_arrays([_developed(*one) for one in _decoded(shots)], shots)

    return {
        f"{OURS} to a mosaic": lambda: merge(shots.bracket).mosaic,
        f"{OURS} to an image": ours_demosaiced,
        "HDRMerge to a mosaic, a DNG": _hdrmerge(shots),
        "HDRutils to an image": _hdrutils(shots, solve),
        "rawpy and colour-hdri to a mosaic": after(_as_colour_hdri),
    }


def _as_colour_hdri(linear, shots: Shots):
    size = shots.world.shape[0], -1, 3
    run = _colour_hdri([values.reshape(size) for values in linear], shots.times_s)
    if isinstance(run, str):
        raise ImportError(run)
    return run()


def _hdrmerge(shots: Shots) -> Run | str:
    """Alignment and cropping off, which a tripod needs not; 32 bits, as the black level it adds
    leaves 16 no shadows; no preview."""
    program = shutil.which("hdrmerge")
    if program is None:
        return "no program hdrmerge; apt-get install hdrmerge"
    if not find_spec("tifffile"):
        return "its result wants tifffile; pip install 'sixlight[bench]'"
    out = shots.files[0].parent / "hdrmerge.dng"

    def run():
        command = [program, "-o", str(out), "--no-align", "--no-crop", "-p", "none", "-b", "32"]
        subprocess.run(
            [*command, *map(str, shots.files)],
            check=True,
            capture_output=True,
            env=os.environ | {"QT_QPA_PLATFORM": "offscreen"},
        )
        return _read_dng(out)

    return run


def _read_dng(path: Path) -> NDArray[np.float64]:
    """A mosaic of floating-point numbers, above black; LibRaw would round it."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        first = file.pages[0]
        page = next(p for p in [first, *(first.pages or [])] if p.photometric == 32803)
        black = float(np.mean(page.tags["BlackLevel"].value))
        return page.asarray().astype(np.float64) - black


def _hdrutils(shots: Shots, solve: bool) -> Run | str:
    """Merging the mosaic, as its authors do for accuracy; it demosaics always, bilinearly at least,
    which leaves samples as they are. Exposures by "mst" (Hanji et al. 2023), its best, or tags."""
    if not find_spec("HDRutils"):
        return "pip install 'sixlight[bench]'"
    import logging

    import HDRutils

    logging.getLogger("HDRutils").setLevel(logging.ERROR)

    def run():
        merged, _ = HDRutils.merge(
            [str(path) for path in shots.files],
            demosaic_first=False,
            color_space="raw",
            exp=shots.times_s,
            gain=[ISO / 100] * len(shots.files),
            aperture=1.0,
            estimate_exp="mst" if solve else None,
        )
        mosaic = np.empty(merged.shape[:2], merged.dtype)
        for row, column in PLACES:
            mosaic[row::2, column::2] = merged[row::2, column::2, row + column]
        return mosaic

    return run


def _decoded(shots: Shots) -> list[tuple[NDArray[np.uint16], Frame]]:
    """The files' samples by LibRaw, and the frame of each for its levels."""
    import rawpy

    def one(path: Path) -> NDArray[np.uint16]:
        with rawpy.imread(str(path)) as raw:
            return raw.raw_image_visible.copy()

    with ThreadPoolExecutor(workers()) as pool:
        return list(zip(pool.map(one, shots.files), shots.frames, strict=True))


def _developed(samples, of: Frame) -> NDArray[np.float32]:
    black, full = of.black_level[0, 0], of.saturation_level[0, 0]
    return np.clip((samples.astype(np.float32) - np.float32(black)) / (full - black), 0, 1)
