"""Compares a result with the truth of the simulated capture it was made from.

    python -m benchmarks.check_sample [RESULT] [--capture DIR] [--json FILE]

RESULT (default build/room) holds `cubemap.exr`, DIR (default sample_captures/room) `truth/`. Prints
a table and ends with status 1 when a bound does not hold. Each figure's function says how it is
made.

The sphere does not show what is behind it, nor where its stand is; those texels, and any the
result itself calls unknown, are left out of both sides of every comparison but the white patch's:
an irradiance needs all directions, so there they hold the truth's values on both sides.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.figure import Figure
from calibration import primaries, sets
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError
from calibration.optimise import adapted_lab, true_lab
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra
from pipeline.io import read_exr
from stages import cube

FACE = 64  # texels along a face everything is compared at: 1.4 degrees
SEEN_WITHIN = np.cos(np.radians(135.0))  # of +Z, the way to the camera
LOW_PASS_DEGREES = 3.0  # full width at half maximum of the Gaussian
SQUASH = 0.02  # of the mean radiance: where a logarithm of light goes over into a line


@dataclass(frozen=True)
class Compared:
    """A result and the truth at the same size: values (6, N, N, P), known (6, N, N) in both."""

    result: np.ndarray
    truth: np.ndarray
    spectra: np.ndarray
    known: np.ndarray
    primaries: Primaries


def read_faces(path: Path) -> dict[str, np.ndarray]:
    """Channels of a cubemap EXR by name, each (6, N, N)."""
    pixels, names, _ = read_exr(path)
    n = pixels.shape[1]
    return {name: pixels[..., i].reshape(6, n, n) for i, name in enumerate(names)}


def at_size(values, weight, size: int):
    """A cubemap (6, N, N, C) and its weight (6, N, N) at another size, areas averaged by weight.

    A larger size is reached by bilinear interpolation first.
    """
    n = values.shape[1]
    whole = size * -(-n // size)
    values = np.where(weight[..., None] > 0, values, 0.0)
    if whole != n:
        directions = cube.directions(whole)
        values = cube.sample(values * weight[..., None], directions)
        weight = cube.sample(weight[..., None], directions)[..., 0]
        values = values / np.maximum(weight, 1e-9)[..., None]
    k = whole // size
    w = (weight * cube.solid_angles(whole)).reshape(6, size, k, size, k)
    v = values.reshape(6, size, k, size, k, -1)
    total = w.sum(axis=(2, 4))
    mean = (v * w[..., None]).sum(axis=(2, 4)) / np.maximum(total, 1e-30)[..., None]
    solid = cube.solid_angles(whole).reshape(size, k, size, k).sum(axis=(1, 3))
    return mean, total / solid


def read(result: Path, truth: Path) -> Compared:
    """A result and the truth, its 36 bands projected to the primaries the result names."""
    names = tuple(f"{w:.0f}nm" for w in WAVELENGTHS)
    header = read_exr(result / "cubemap.exr")[2]
    light = primaries.load(header.get("primaries", primaries.DEFAULT))

    def stacked(path: Path, wanted):
        channels = read_faces(path)
        values = np.stack([channels[name] for name in wanted], axis=-1).astype(np.float64)
        weight = channels.get("valid", np.ones(values.shape[:3])).astype(np.float64)
        return at_size(values, np.where(np.isfinite(values).all(axis=-1), weight, 0.0), FACE)

    got, got_known = stacked(result / "cubemap.exr", light.channels)
    spectra, _ = stacked(truth / "spectral.exr", names)
    _, true_known = stacked(truth / "cubemap.exr", ["valid"])
    known = (got_known > 0.5) & (true_known > 0.5)
    return Compared(got, light.project(spectra), spectra, known, light)


def directions_right(c: Compared) -> list[Figure]:
    """Which way round the result is, by correlation and by a solved rotation.

    All 48 ways to permute and flip the axes, mirrored ones included, are tried on the squashed
    logarithm of the light; the identity's rank among them must be first. Then the small rotation
    that fits best is solved for by Gauss-Newton on the same picture, smoothed to 3 degrees.
    """
    directions = cube.directions(FACE)

    def picture(values):
        light = values.sum(axis=-1)
        return np.log(np.maximum(light, 0) / light[c.known].mean() + SQUASH)[..., None]

    smooth = low_pass(FACE)
    seen = c.known & (directions[..., 2] > SEEN_WITHIN)
    true = smooth(picture(c.truth), c.known)[..., 0]
    got = smooth(picture(np.where(c.known[..., None], c.result, c.truth)), c.known)
    weight = np.broadcast_to(cube.solid_angles(FACE), seen.shape)[seen]

    def correlation(matrix):
        turned = cube.sample(got, directions[seen] @ matrix.T)[:, 0]
        return np.cov(turned, true[seen], aweights=weight, ddof=0)

    scores = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.diag(signs)[:, order]
            cov = correlation(matrix)
            scores[matrix.tobytes()] = cov[0, 1] / np.sqrt(cov[0, 0] * cov[1, 1])
    identity = scores.pop(np.eye(3).tobytes())
    turn = Rotation.identity()
    for _ in range(8):
        base = cube.sample(got, turn.apply(directions[seen]))[:, 0]
        step = np.radians(0.5)
        slopes = []
        for axis in np.eye(3):
            ahead, behind = (
                cube.sample(got, (Rotation.from_rotvec(s * axis) * turn).apply(directions[seen]))
                for s in (step, -step)
            )
            slopes.append((ahead - behind)[:, 0] / (2 * step))
        slopes.append(np.ones_like(base))  # the pictures' levels may differ
        a = np.stack(slopes, axis=1) * np.sqrt(weight)[:, None]
        b = (true[seen] - base) * np.sqrt(weight)
        # A lamp a little aside is an outlier of the linearisation: Huber's weights.
        scale = 1.5 * np.median(np.abs(b)) + 1e-12
        robust = np.sqrt(np.minimum(1.0, scale / np.maximum(np.abs(b), 1e-12)))
        solved, *_ = np.linalg.lstsq(a * robust[:, None], b * robust, rcond=None)
        turn = Rotation.from_rotvec(solved[:3]) * turn
    return [
        Figure("correlation as it is", identity, "", low=max(scores.values()), high=1.0),
        Figure("correlation, best other of 48", max(scores.values()), ""),
        Figure("rotation left", float(np.degrees(turn.magnitude())), "degrees", high=1.0),
    ]


def low_pass(size: int):
    """A function that smooths a cubemap (6, N, N, C) over known texels (6, N, N)."""
    directions = cube.directions(size).reshape(-1, 3)
    sigma = np.radians(LOW_PASS_DEGREES) / np.sqrt(8 * np.log(2))
    tree = cKDTree(directions)
    pairs = tree.sparse_distance_matrix(tree, 3 * sigma, output_type="coo_matrix")
    solid = np.tile(cube.solid_angles(size).ravel(), 6)
    kernel = csr_array(
        (np.exp(-0.5 * (pairs.data / sigma) ** 2) * solid[pairs.col], (pairs.row, pairs.col)),
        shape=pairs.shape,
    )

    def smooth(values, known):
        w = known.reshape(-1, 1).astype(np.float64)
        v = np.where(w > 0, values.reshape(len(directions), -1), 0.0)
        return ((kernel @ v) / np.maximum(kernel @ w, 1e-30)).reshape(values.shape)

    return smooth


def radiance_right(c: Compared) -> list[Figure]:
    """Scale, and the six channels low-passed to 3 degrees, within 135 degrees of the camera."""
    seen = c.known & (cube.directions(FACE)[..., 2] > SEEN_WITHIN)
    solid = np.broadcast_to(cube.solid_angles(FACE), seen.shape)[seen][:, None]
    smooth = low_pass(FACE)
    got, true = smooth(c.result, c.known)[seen], smooth(c.truth, c.known)[seen]
    error = np.abs(got / true - 1)
    figures = [
        Figure(
            "scale, total light", float((got * solid).sum() / (true * solid).sum()), "", 0.97, 1.03
        ),
        Figure("scale, median of directions", float(np.median(got / true)), "", 0.97, 1.03),
        Figure("relative error, median", 100 * float(np.median(error)), "%", high=6.0),
        Figure("relative error, 95th percentile", 100 * float(np.percentile(error, 95)), "%"),
    ]
    for i, name in enumerate(c.primaries.channels):
        figures.append(
            Figure(f"  {name}, median", 100 * float(np.median(error[:, i])), "%", high=6.0)
        )
    return figures


@dataclass(frozen=True)
class Irradiances:
    """On a patch facing each of 1536 directions, over pi: what a perfect white there returns.

    got, true  (1536, P) in the primaries: the result's, and the truth's
    spectra    (1536, 36) the truth's
    """

    got: np.ndarray
    true: np.ndarray
    spectra: np.ndarray

    @classmethod
    def of(cls, c: Compared) -> Irradiances:
        """Of a result; what it does not know is the truth's."""
        normals = cube.directions(16).reshape(-1, 3)
        d = cube.directions(FACE).reshape(-1, 3)
        solid = np.tile(cube.solid_angles(FACE).ravel(), 6)
        facing = np.clip(normals @ d.T, 0, None) * solid / np.pi
        filled = np.where(c.known[..., None], c.result, c.truth)
        return cls(*(facing @ light.reshape(len(d), -1) for light in (filled, c.truth, c.spectra)))


def white_right(c: Compared) -> list[Figure]:
    """CIEDE2000 of a perfect white patch facing each of 1536 directions.

    Irradiance over the patch's hemisphere, to XYZ by the primaries' 3 x 6 matrix. The observer is
    adapted to the light on the patch: white is the truth's own XYZ there, so that the truth's patch
    is L* 100, a* b* 0 everywhere. Printed without a bound: the same with the truth's mean over all
    directions as white, and against XYZ from the truth's 36 bands.
    """
    white = Irradiances.of(c)
    got = white.got @ c.primaries.xyz_from_primaries.T
    true = white.true @ c.primaries.xyz_from_primaries.T
    full = sets.xyz(white.spectra)

    def own(a, b):
        return np.array([delta_e_2000(lab(x, y), lab(y, y)) for x, y in zip(a, b, strict=True)])

    mean = true.mean(axis=0)
    by_mean = delta_e_2000(lab(got, mean), lab(true, mean))
    six, spectral, floor = own(got, true), own(got, full), own(true, full)
    return [
        Figure("white patch dE2000, median", float(np.median(six)), "", high=0.5),
        Figure("white patch dE2000, 95th percentile", float(np.percentile(six, 95)), "", high=1.2),
        Figure("  the same, white = mean light, median", float(np.median(by_mean)), ""),
        Figure("  the same, 95th percentile", float(np.percentile(by_mean, 95)), ""),
        Figure("  against full spectra, median", float(np.median(spectral)), ""),
        Figure("  against full spectra, 95th percentile", float(np.percentile(spectral, 95)), ""),
        Figure("  truth's six channels against spectra, median", float(np.median(floor)), ""),
    ]


def paint_right(c: Compared) -> list[Figure]:
    """CIEDE2000 of the ColorChecker's 24 patches facing each of 1536 directions.

    The whole error of what is rendered: from the photographs to light times reflectance in the
    primaries, against the truth's 36 bands; adapted from the true light on the patch to D65.
    """
    on_patch = Irradiances.of(c)
    names = tuple(str(i) for i in range(len(on_patch.spectra)))
    lights = Spectra(WAVELENGTHS, names, on_patch.spectra.T)
    patches = sets.surfaces("colorchecker24")
    true = true_lab(lights, patches)

    def errors(light):
        products = light[:, None, :] * c.primaries.project(patches.values.T)
        rendered = products @ c.primaries.xyz_from_primaries.T
        return delta_e_2000(true, adapted_lab(rendered, lights))

    whole, floor = errors(on_patch.got), errors(on_patch.true)
    return [
        Figure("ColorChecker dE2000, mean", float(whole.mean()), ""),
        Figure("ColorChecker dE2000, 90th percentile", float(np.percentile(whole, 90)), ""),
        Figure("  of which rendering in the primaries, mean", float(floor.mean()), ""),
    ]


def compare(result: Path, capture: Path) -> list[Figure]:
    compared = read(result, capture / "truth")
    checks = (directions_right, radiance_right, white_right, paint_right)
    return [figure for check in checks for figure in check(compared)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", nargs="?", type=Path, default=Path("build/room"))
    parser.add_argument("--capture", type=Path, default=Path("sample_captures/room"))
    parser.add_argument("--json", type=Path, help="write the figures there, too")
    arguments = parser.parse_args()
    try:
        figures = compare(arguments.result, arguments.capture)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    for figure in figures:
        print(figure)
    if arguments.json:
        rows = [figure.row() for figure in figures]
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")
    return 0 if all(figure.holds is not False for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
