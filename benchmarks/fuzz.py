"""Feeds mutated files to all that reads a user's files, and keeps those that do harm.

    python -m benchmarks.fuzz [COUNT] [--only KIND] [--seed N] [--keep DIR]

A file does harm where reading it ends in anything but its content or an InputError: another
exception, a crash, more than ten seconds, more than 4 GB. Inputs are read in child processes; one
that dies is replaced. What did harm is written to DIR (tests/fuzz), named by kind and digest, for
tests/test_fuzz.py to read for ever after.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from calibration.errors import InputError

LIMIT_S, LIMIT_BYTES = 10.0, 4 << 30
_BATCH = 200  # inputs a child reads before another takes its place


# ------------------------------------------------------------------------------- what reads files


def _raw(path: Path) -> None:
    from pipeline import io

    shot = io.read_shot(path, time_s=0.1)
    given = {"time_s": shot.time_s, "iso": shot.iso, "f_number": shot.f_number}
    io.read_frame(path, **given)


def _capture(path: Path) -> None:
    """A capture.toml among two filters' photographs, small ones."""
    from pipeline import capture

    place = path.parent / "capture"
    if not place.is_dir():
        _photographs(place)
    os.replace(path, place / "capture.toml")
    capture.load(place)


def _transform(path: Path) -> None:
    from calibration.transform import read_transform

    read_transform(path)


def _spectra(path: Path) -> None:
    from calibration.spectra import read_spectra

    read_spectra(path, "power")


def _display(path: Path) -> None:
    from calibration import measured_display

    measured_display.read(path)


def _image(path: Path) -> None:
    from pipeline import io

    io.read_measured(path, cube=True)


def _mesh(path: Path) -> None:
    from pipeline.files import meshes

    meshes.read(path)


READERS: dict[str, Callable[[Path], None]] = {
    "raw.dng": _raw,
    "capture.toml": _capture,
    "transform.toml": _transform,
    "spectra.csv": _spectra,
    "display.csv": _display,
    "map.exr": _image,
    "mesh.obj": _mesh,
    "mesh.gltf": _mesh,
    "mesh.glb": _mesh,
}
"""By kind, whose end is a file's suffix, what reads it."""


def read(kind: str, path: Path) -> str | None:
    """Reads a file as its kind is read; what harm it did, or None."""
    try:
        READERS[kind](path)
    except InputError as error:
        if len(str(error)) > 20_000:
            return "an error of more than 20000 characters"
    except Exception as error:  # whatever it is: that is the question
        return f"{type(error).__name__}: {error}"[:200]
    return None


# ------------------------------------------------------------------------------------------ seeds


def seeds(folder: Path) -> dict[str, bytes]:
    """A good file of each kind."""
    sys.path.insert(0, "tests")
    import numpy as np
    import small_capture
    import trimesh

    from calibration import primaries, transform
    from calibration.fit import fit
    from calibration.spectra import to_csv
    from calibration.training import computed
    from pipeline import io
    from stages.types import Measured

    rng = np.random.default_rng(0)
    small_capture.write_shot(folder / "raw.dng", rng.integers(500, 15000, (24, 32), np.uint16))
    curves = small_capture.sensitivities(), small_capture.transmittances()
    fitted = fit(computed(*curves), primaries.load())
    cube = rng.random((6, 4, 4, 6), np.float32)
    light = Measured(cube, cube, np.ones(cube.shape[:3], np.float32))
    io.write_measured(folder / "map.exr", light, [f"P{i}" for i in range(1, 7)], {"step": "x"})
    box = trimesh.creation.box()
    drives = ["R,G,B,X,Y,Z"] + [
        f"{r},{g},{b},{0.4 * r + 0.3 * g + 0.2 * b + 0.1},{0.2 * r + 0.7 * g + 0.1 * b + 0.1},"
        f"{0.02 * r + 0.1 * g + 0.9 * b + 0.1}"
        for r in (0, 128, 255)
        for g in (0, 128, 255)
        for b in (0, 128, 255)
    ]
    return {
        "raw.dng": (folder / "raw.dng").read_bytes(),
        "capture.toml": _MANIFEST,
        "transform.toml": transform.to_toml(fitted).encode(),
        "spectra.csv": to_csv(small_capture.sensitivities()).encode(),
        "display.csv": "\n".join(drives).encode(),
        "map.exr": (folder / "map.exr").read_bytes(),
        "mesh.obj": trimesh.exchange.obj.export_obj(box).encode(),
        "mesh.gltf": _embedded(trimesh.exchange.gltf.export_gltf(trimesh.Scene(box))),
        "mesh.glb": trimesh.exchange.gltf.export_glb(trimesh.Scene(box)),
    }


_MANIFEST = b"""name = "office"
[[filter]]
name = "cyan"
files = "cyan/*"
times_s = [0.1, 0.2]
[[filter]]
name = "yellow"
[sphere]
radius_mm = 50.0
distance_mm = 1500.0
material = "stainless steel"
outline = [16.0, 12.0, 9.0]
[camera]
focal_length_mm = 100.0
pixel_pitch_um = 4.3
distortion = [0.01, 0.0, 0.0]
[room]
size_m = [4.8, 2.6, 5.8]
sphere_m = [2.3, 1.25, 2.6]
[mask]
polygons = [[[1, 1], [5, 1], [5, 5]]]
[[noise]]
iso = 100
full_scale_electrons = 40000
read_electrons = 4
[orientation]
yaw_deg = 10.0
"""


def _embedded(files: dict[str, bytes]) -> bytes:
    """A glTF with its buffers within."""
    import base64

    text = files["model.gltf"].decode()
    for name, content in files.items():
        if name != "model.gltf":
            within = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
            text = text.replace(f'"{name}"', f'"{within}"')
    return text.encode()


def _photographs(folder: Path) -> None:
    import numpy as np
    import small_capture

    for name in ("cyan", "yellow"):
        (folder / name).mkdir(parents=True)
        for i in range(2):
            raw = np.full((24, 32), 900, np.uint16)
            small_capture.write_shot(folder / name / f"{i}.dng", raw, small_capture.TAGS[i])


# -------------------------------------------------------------------------------------- mutations

_INTERESTING = (b"\0", b"\xff", b"\x80", b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"\0\0\0\x80")
_WORDS = (
    b"",
    b"-1",
    b"0",
    b"1e999",
    b"nan",
    b"-inf",
    b"9" * 40,
    b"1e-320",
    b'"',
    b"[",
    b"{",
    b"\n",
)
_WORDS += (b"true", b"'''", b"\xe2\x80\xae", b"\0", b"../..", b"/dev/zero", b"[" * 500, b"null")


def mutated(seed: bytes, rng: random.Random, textual: bool) -> bytes:
    """A file with one to six things done to it."""
    content = bytearray(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        _MUTATIONS[rng.randrange(len(_MUTATIONS))](content, rng)
        if textual and rng.random() < 0.6:
            _word(content, rng)
    return bytes(content[: 1 << 20])


def _flip(c: bytearray, rng: random.Random) -> None:
    if c:
        c[rng.randrange(len(c))] ^= 1 << rng.randrange(8)


def _overwrite(c: bytearray, rng: random.Random) -> None:
    at, new = rng.randrange(len(c) + 1), rng.choice(_INTERESTING)
    c[at : at + len(new)] = new


def _header(c: bytearray, rng: random.Random) -> None:
    """As the others, but where a file says what is in it."""
    at, new = rng.randrange(min(len(c), 400) + 1), rng.choice(_INTERESTING)
    c[at : at + len(new)] = new


def _cut(c: bytearray, rng: random.Random) -> None:
    del c[rng.randrange(len(c) + 1) :]


def _drop(c: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(c) + 1)
    del c[at : at + rng.randrange(1, 64)]


def _twice(c: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(c) + 1)
    c[at:at] = c[at : at + rng.randrange(1, 200)] * rng.choice((1, 1, 2, 50))


def _word(c: bytearray, rng: random.Random) -> None:
    """A number or a word of a text becomes another."""
    found = list(re.finditer(rb"[\w.+-]+", bytes(c[:20_000])))
    if found:
        word = rng.choice(found)
        c[word.start() : word.end()] = rng.choice(_WORDS)


_MUTATIONS = (_flip, _flip, _overwrite, _header, _cut, _drop, _twice)


# --------------------------------------------------------------------------------------- the hunt


@dataclass(frozen=True)
class Harm:
    """A file that did harm."""

    kind: str
    what: str
    content: bytes


def hunt(kind: str, seed: bytes, count: int, number: int, folder: Path) -> Iterator[Harm]:
    """Reads `count` mutations of a good file; those that did harm, as they are met."""
    context = multiprocessing.get_context("fork")
    done = 0
    while done < count:
        ours, theirs = context.Pipe(duplex=False)
        until = min(done + _BATCH, count)
        child = context.Process(
            target=_read_many, args=(kind, seed, done, until, number, folder, theirs)
        )
        child.start()
        theirs.close()
        current, what = done, None
        while True:
            if not ours.poll(LIMIT_S):
                what = f"more than {LIMIT_S:g} s"
                child.kill()
            try:
                current, said = ours.recv()
            except EOFError:
                break
            if said is not None:
                yield Harm(kind, said, _content(kind, seed, current, number))
            current += 1
        child.join()
        if current < until:
            code = child.exitcode or 0
            name = signal.Signals(-code).name if code < 0 else f"status {code}"
            yield Harm(kind, what or name, _content(kind, seed, current, number))
        done = max(current, done) + (current < until)


def _content(kind: str, seed: bytes, index: int, number: int) -> bytes:
    rng = random.Random(f"{kind} {number} {index}")
    return mutated(seed, rng, textual=kind.endswith((".toml", ".csv", ".obj", ".gltf")))


def _read_many(kind, seed, first, last, number, folder, told) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    path = folder / f"input{Path(kind).suffix}"
    for index in range(first, last):
        path.write_bytes(_content(kind, seed, index, number))
        told.send((index, read(kind, path)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=100_000, help="inputs in all")
    parser.add_argument("--only", choices=list(READERS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("tests/fuzz"))
    given = parser.parse_args()
    kinds = [given.only] if given.only else list(READERS)
    harmful = 0
    with tempfile.TemporaryDirectory() as place:
        good = seeds(Path(place))
        for kind in kinds:  # what is imported once is not imported in every child
            path = Path(place) / f"good{Path(kind).suffix}"
            path.write_bytes(good[kind])
            found = read(kind, path)
            assert found is None, f"the good {kind}: {found}"
        for kind in kinds:
            began, kept = time.monotonic(), {}
            count = given.count // len(kinds)
            for harm in hunt(kind, good[kind], count, given.seed, Path(place)):
                kept.setdefault(re.sub(r"[\d'\"].*", "", harm.what), harm)  # one of each sort
                harmful += 1
            seconds = time.monotonic() - began
            print(f"{kind:16s} {count:7d} inputs {seconds:7.1f} s  {len(kept)} sorts of harm")
            for harm in kept.values():
                name = f"{hashlib.sha256(harm.content).hexdigest()[:8]}.{kind}"
                given.keep.mkdir(parents=True, exist_ok=True)
                (given.keep / name).write_bytes(harm.content)
                print(f"    {name}: {harm.what}", flush=True)
    return 1 if harmful else 0


if __name__ == "__main__":
    sys.exit(main())
