"""Radiometry: a merged bracket against known truth, against reading the files, and beside peers.

Brackets are made up over 13 stops with sensors of 10 to 14 bit. The bound of a variance is
Cramer and Rao's: the information of all samples that did not saturate, added up.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import merge_peers, spent
from benchmarks.figure import Figure
from pipeline.bracket import Bracket, frames
from pipeline.files import decoding, raw
from pipeline.simulate.camera import Camera, Shutter, expose
from pipeline.simulate.dng import Shot, write_dng
from stages.bracket import workers
from stages.compiled import compile_all
from stages.find import Found, find
from stages.merge import InMemory, merge
from stages.mirror import Sphere
from stages.types import Frame

RGGB = np.array([[0, 1], [1, 2]])
TAGS_S = 2.0 ** np.arange(-10, 1, 2.0)  # six exposures, two stops apart
OFF = np.array([1.03, 0.93, 1.0, 1.05, 0.97, 1.02])  # by what the shutter strays from its tags


@dataclass(frozen=True)
class Sensor:
    """bits of the converter, electrons of full scale, read noise in electrons."""

    bits: int
    electrons: float
    read: float

    @property
    def black(self) -> int:
        return 2**self.bits // 16

    @property
    def levels(self) -> int:
        return 2**self.bits - 1 - self.black

    def shoot(self, world, time_s: float, tag_s: float, rng, dark=0.0) -> Frame:
        """A raw file of a world (H, W) in full scale per second."""
        seen = rng.poisson(np.minimum((world + dark) * time_s, 20) * self.electrons)
        signal = (seen + rng.normal(0, self.read, world.shape)) / self.electrons
        raw = np.clip(np.round(self.black + signal * self.levels), 0, 2**self.bits - 1)
        black = np.full((2, 2), float(self.black))
        return Frame(raw.astype(np.uint16), RGGB, black, black + self.levels, tag_s, 100.0, 1.0)

    def information(self, world, times_s):
        """Of each exposure about the world, per unit: (K, ...)."""
        world = np.asarray(world)[None]
        t = np.reshape(times_s, (-1, *[1] * (world.ndim - 1)))
        noise = world * t / self.electrons + (self.read / self.electrons) ** 2
        noise += 1 / self.levels**2 / 12
        return (world * t < 0.95) * t**2 / noise


CAMERA = replace(Camera(), width=5184, height=3456)  # of the files
SPHERE = {"radius_mm": 50.0, "distance_mm": 1500.0}

SENSORS = (Sensor(10, 8000, 12), Sensor(12, 30000, 6), Sensor(14, 40000, 3), Sensor(14, 80000, 4))


def measure() -> Iterator[Figure]:
    compile_all()
    for sensor in SENSORS:
        yield from _levels(sensor)
    yield from _pixels()
    yield from _movement()
    yield from _peers()
    yield from _files()
    yield from _region()


def _levels(sensor: Sensor) -> Iterator[Figure]:
    """Stripes from read noise in the longest exposure to near saturation in the shortest."""
    name = f"{sensor.bits} bit, {sensor.electrons:.0f} e-"
    rng = np.random.default_rng(sensor.bits)
    lowest = max(sensor.read / sensor.electrons, 0.5 / sensor.levels)
    levels = np.geomspace(lowest, 0.8 / TAGS_S[0], 36)
    # As many pixels as it takes to see a bias of .2 %, up to a million a stripe.
    sure = 0.0004 * levels * np.sqrt(sensor.information(levels, TAGS_S * OFF).sum(axis=0))
    columns = np.clip(np.ceil(1 / sure**2 / 1000 / 2) * 2, 32, 1000).astype(int) + 8
    world = np.repeat(levels, columns)[None].repeat(1000, axis=0)
    times = TAGS_S * OFF
    result = merge(
        InMemory([sensor.shoot(world, t, tag, rng) for t, tag in zip(times, TAGS_S, strict=True)])
    )
    off = np.array(result.solved) / times
    scale = off.mean()
    bound = 1 / sensor.information(levels, times).sum(axis=0)
    bias, spread, sigma = [], [], []
    ends = np.cumsum([0, *columns])
    for left, right, level, best in zip(ends, ends[1:], levels, bound, strict=False):
        inner = slice(left + 4, right - 4)
        values = result.mosaic[:, inner].astype(np.float64) * scale
        error = values.std() / level / np.sqrt(values.size)
        bias.append(max(abs(values.mean() / level - 1) - 3 * error, 0))
        spread.append(values.var() / best)
        said = np.sqrt(result.variance[:, inner].mean(dtype=np.float64)) * scale
        sigma.append(said / values.std() - 1)
    yield Figure(f"{name}, bias at any level, less 3 s.e.", 100 * max(bias), "%", high=0.2)
    clear = levels * times[:, None]
    sharp = ~((clear > 0.9) & (clear < 1.05)).any(axis=0)  # not where half of a stripe saturates
    yield Figure(f"{name}, variance over its bound", np.max(np.array(spread)[sharp]), "", high=1.1)
    yield Figure(f"{name}, sigma said, worst", 100 * np.abs(sigma)[sharp].max(), "%", high=10)
    yield Figure(f"{name}, ratios of shutters", 100 * np.abs(off / scale - 1).max(), "%", high=0.1)


def _scene(rng, size=(800, 1000)):
    import cv2

    coarse = rng.normal(0, 1, (size[0] // 40, size[1] // 40))
    return 0.3 * np.exp2(3 * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC))


def _pixels() -> Iterator[Figure]:
    """Hot pixels that matter: half of the light about them and fifteen sigmas, or more."""
    sensor, rng = SENSORS[1], np.random.default_rng(2)
    world = _scene(rng, (1600, 2000))
    hot = rng.random(world.shape) < 2e-4
    dark = np.where(hot, 10 ** rng.uniform(-2, 1, world.shape), 0)
    result = merge(InMemory([sensor.shoot(world, t, t, rng, dark) for t in TAGS_S]))
    sigma = 1 / np.sqrt(sensor.information(world, TAGS_S).sum(axis=0))
    inside = np.zeros_like(hot)
    inside[2:-2, 2:-2] = True
    matter = hot & inside & (dark > 0.5 * world) & (dark > 15 * sigma)
    yield Figure("hot pixels found", 100 * result.defective[matter].mean(), "%", low=99)
    yield Figure("good pixels taken for hot", result.defective[~hot].mean(), "", high=1e-4)


def _movement() -> Iterator[Figure]:
    """Things of 40 px in one exposure of six, brighter or darker."""
    sensor, rng = SENSORS[1], np.random.default_rng(5)
    world = _scene(rng)
    y, x = np.mgrid[: world.shape[0], : world.shape[1]]
    near = [((i % 120) >= 40 - m) & ((i % 120) < 80 + m) for m in (-1, 2) for i in (x, y)]
    inner, outer = near[0] & near[1], ~(near[2] & near[3])
    thing = ((x % 120) // 40 == 1) & ((y % 120) // 40 == 1)
    information = sensor.information(world, TAGS_S)
    found, biases, false = [], [], []
    for change in (-0.3, 0.15, 0.3):
        for k in (2, 3, 4, 5):
            changed = np.where(thing, world * (1 + change), world)
            frames = [
                sensor.shoot(changed if i == k else world, t, t, rng) for i, t in enumerate(TAGS_S)
            ]
            result = merge(InMemory(frames))
            others = information.sum(axis=0) - information[k]
            seen = inner & (information[k] > 0) & (others > 0) & (changed * TAGS_S[k] < 0.9)
            with np.errstate(divide="ignore"):
                sigmas = np.abs(change) * world / np.sqrt(1 / information[k] + 1 / others)
            seen &= (sigmas > 5) & (sigmas < 10) & result.valid
            found.append(result.moved[seen])
            sigma = 1 / np.sqrt(information.sum(axis=0))
            biases.append(((result.mosaic - world) / sigma)[seen])
            false.append(result.moved[outer])
    rate, false_rate = (np.concatenate(v).mean() for v in (found, false))
    bias = np.concatenate(biases).mean()
    yield Figure("changes of 5 to 10 sigmas found", 100 * rate, "%", low=95)
    yield Figure("still pixels taken for moved", 100 * false_rate, "%", high=1)
    yield Figure("bias of the value where it moved", abs(bias), "sigma", high=0.2)


# ------------------------------------------------------------------------------------- peers


def _peers() -> Iterator[Figure]:
    """The same bracket merged by each; see `merge_peers`."""
    sensor, rng = SENSORS[2], np.random.default_rng(7)
    world = _scene(rng, (2000, 3000))
    with tempfile.TemporaryDirectory() as folder:
        true, astray = (
            merge_peers.photographed(
                [
                    sensor.shoot(world, time_s, tag, rng)
                    for time_s, tag in zip(times_s, TAGS_S, strict=True)
                ],
                world,
                Path(folder),
                name,
            )
            for name, times_s in (("true", TAGS_S), ("astray", TAGS_S * OFF))
        )
        yield from merge_peers.compared(true, astray)


# ------------------------------------------------------------------------------------- files


def _files() -> Iterator[Figure]:
    """Two brackets of seven lossless 18-megapixel DNGs: against unpacking them, and memory."""
    with tempfile.TemporaryDirectory() as folder:
        brackets = _photograph(Path(folder), filters=2, exposures=7)
        ours, unpacked = [], []
        for bracket in brackets * 2:  # alternating, as other work on the machine comes and goes
            unpacked.append(_timed(lambda b=bracket: _unpack(b)))
            ours.append(_timed(lambda b=bracket: merge(b)))
        wall, cpu = (
            np.sum([v[i] for v in ours]) / np.sum([v[i] for v in unpacked]) for i in (0, 1)
        )
        yield Figure("develop + merge over unpacking, wall", wall, "times", high=1.25)
        yield Figure("develop + merge over unpacking, CPU", cpu, "times")
        yield from _apart(brackets[0])
        peaks = [_peak_mb(brackets[0], count) for count in (3, 12)]
        for count, peak in zip((3, 12), peaks, strict=True):
            yield Figure(f"peak memory, {count} exposures of 18 MP", peak, "MB", high=1000)


def _apart(bracket: Bracket) -> Iterator[Figure]:
    """What it costs that files are decoded in processes of their own: a file, and once."""

    def here(function, *given, **named):
        return function(*given, **named)

    decoding.stop()
    _, cpu = _timed(lambda: decoding.run(raw.recognised, bracket.files[0]))
    yield Figure("starting a process that decodes, CPU", cpu, "s")
    files = bracket.files[::3]
    took = np.empty((_ROUNDS, len(files), 2, 2))
    with tempfile.TemporaryFile(dir=bracket.folder) as spool:
        file = spool.fileno()
        for i, j, k in np.ndindex(took.shape[:3]):  # one way, and then the other
            run = (here, decoding.run)[k]
            took[i, j, k] = _timed(partial(run, raw.decode, files[j], file=file))
    # Other work on the machine makes nothing faster by the clock, and CPU scatter either way.
    for i, what, typical in ((0, "wall", np.min), (1, "CPU", np.median)):
        together, apart = typical(took[..., i], axis=0).sum(axis=0)
        name = f"decoding in a process of its own, {what}"
        yield Figure(name, apart / together, "times", high=1.05)


_ROUNDS = 10


def _photograph(folder: Path, *, filters: int, exposures: int) -> list[Bracket]:
    import cv2

    camera = CAMERA
    rng = np.random.default_rng(1)
    brackets = []
    for f in range(filters):
        coarse = rng.normal(0, 1, (camera.height // 96, camera.width // 96)).astype(np.float32)
        size = camera.width, camera.height
        world = np.exp2(2.2 * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC))
        world *= 0.1 * camera.full_well
        world[1000:1100, 2000:2100] *= 1e3  # a lamp
        brackets.append(_bracket(folder, f"{f}", world, rng, exposures))
    return brackets


def _bracket(folder: Path, name: str, world, rng, exposures: int) -> Bracket:
    """A world (H, W) of electrons per second, photographed by CAMERA."""
    files, given = [], []
    for i in range(exposures):
        shutter = Shutter(-30 + 5 * i)
        files.append(folder / f"{name}_{i}.dng")
        shot = Shot(shutter.tag, datetime(2020, 1, 1), (1.0, 1.0, 1.0))
        write_dng(files[-1], expose(world, shutter.time_s, CAMERA, rng), CAMERA, shot, np.eye(3))
        time_s = shutter.tag[0] / shutter.tag[1]
        given.append({"time_s": time_s, "iso": CAMERA.iso, "f_number": CAMERA.f_number})
    return Bracket(files, given, folder)


def _unpack(bracket: Bracket) -> None:
    import rawpy

    def one(path: Path) -> None:
        with rawpy.imread(str(path)) as raw:
            raw.unpack()

    with ThreadPoolExecutor(workers()) as pool:
        list(pool.map(one, bracket.files))


def _timed(function) -> tuple[float, float]:
    """Seconds by the clock, and of processors, those of processes that decode included."""
    wall, cpu = time.perf_counter(), spent.cpu_s()
    function()
    return time.perf_counter() - wall, spent.cpu_s() - cpu


def _region() -> Iterator[Figure]:
    """A sphere that is two thirds as tall as the picture: found first, then no more merged than it.

    Beside the rows of the whole frame: the same seven exposures of 18 megapixels.
    """
    with tempfile.TemporaryDirectory() as folder:
        rng = np.random.default_rng(1)
        bracket = _bracket(Path(folder), "sphere", _sphere_world(), rng, exposures=7)
        found = _found(bracket)
        unpacked, searched, merged = [], [], []
        for _ in range(3):
            unpacked.append(_timed(lambda: _unpack(bracket)))
            searched.append(_timed(lambda: _found(bracket)))
            merged.append(_timed(lambda: merge(replace(bracket, region=found.region))))
    share = f"{100 * found.region.share:.0f} % of the frame"
    unpacking, finding, merging = (np.min(v, axis=0) for v in (unpacked, searched, merged))
    for i, what, bound in ((0, "wall", 1.25), (1, "CPU", None)):
        of_region = merging[i] / unpacking[i]
        both = (finding[i] + merging[i]) / unpacking[i]
        yield Figure(f"{share}: develop + merge over unpacking, {what}", of_region, "times")
        yield Figure(f"{share}: found first, over unpacking, {what}", both, "times", high=bound)


def _sphere_world():
    """Electrons per second (H, W): a wall with a lamp, and a mirror sphere before it."""
    import cv2

    rng, coarser = np.random.default_rng(3), 6
    height, width = CAMERA.height // coarser, CAMERA.width // coarser
    middle = width / 2, height / 2
    sphere = Sphere.from_rim(
        0.52 * width, 0.47 * height, 0.34 * height, principal_px=middle, **SPHERE
    )
    y, x = np.mgrid[:height, :width] + 0.5
    coarse = rng.normal(0, 1, (9, 18)).astype(np.float32)  # as large as furniture
    coarse[:, -1] = coarse[:, 0]  # all around
    latlong = np.exp2(1.5 * cv2.resize(coarse, (1024, 512), interpolation=cv2.INTER_CUBIC))
    latlong[150:180, 400:440] *= 300  # a lamp
    d = sphere.direction_of(np.stack([x, y], axis=-1))
    off = np.isnan(d[..., 0])
    # What is beside the sphere lies behind it: the same world, seen straight through.
    ray = np.stack([x - middle[0], y - middle[1], np.full_like(x, sphere.focal_px)], axis=-1)
    d[off] = (ray @ sphere.world_from_camera.T)[off]
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    u = ((np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi) + 0.5) * 1024).astype(np.float32)
    v = (np.arccos(np.clip(d[..., 1], -1, 1)) / np.pi * 512).astype(np.float32)
    seen = cv2.remap(latlong, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    seen[~off] *= 0.6
    size = CAMERA.width, CAMERA.height
    return 0.1 * CAMERA.full_well * cv2.resize(seen, size, interpolation=cv2.INTER_LINEAR)


def _found(bracket: Bracket) -> Found:
    order = [4, 3, 5]  # brighter ones first, as the step does
    photographs = frames([bracket.files[i] for i in order], [bracket.exposures[i] for i in order])
    with closing(photographs):
        return find(photographs, frame_size=(CAMERA.height, CAMERA.width), **SPHERE)


def _peak_mb(bracket: Bracket, exposures: int) -> float:
    """Largest resident memory of a process that merges so many files, and of those that decode."""
    order = [i % len(bracket.files) for i in range(exposures)]
    arguments = [f"{bracket.files[i]}={bracket.exposures[i]['time_s']!r}" for i in order]
    ran = subprocess.run(
        [sys.executable, "-m", "benchmarks.merge", str(bracket.folder), *arguments],
        check=True,
        capture_output=True,
        text=True,
    )
    return float(ran.stdout)


def _merge_and_tell_memory(folder: str, *arguments: str) -> None:
    pairs = [argument.rsplit("=", 1) for argument in arguments]
    given = [{"time_s": float(time_s), "iso": 100.0, "f_number": 16.0} for _, time_s in pairs]
    merge(Bracket([Path(path) for path, _ in pairs], given, Path(folder)))
    print(spent.peak_mb())


if __name__ == "__main__":
    _merge_and_tell_memory(*sys.argv[1:])
