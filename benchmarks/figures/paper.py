"""The figures of the paper: each function draws one and tells what was measured for it.

Numbers are the paper's: Darling, Ferwerda, Berns, Chen 2011.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.figures.setting import WAYS, Setting, upright
from benchmarks.figures.sheet import GAP, INK, MARGIN, SOFT, Sheet, columns
from calibration import sets
from calibration.channels import SHARP_FROM_XYZ
from calibration.display import encode, shoulder
from calibration.primaries import Primaries, load
from calibration.spectra import WAVELENGTHS
from pipeline import io
from pipeline.compositions import LIGHTS, ROUGHNESSES, compose
from pipeline.materials import Maker
from stages import scenes
from stages.meshes import teapot_mesh
from stages.scene import Camera, Scene, turned
from stages.shadows import sight

PAINTS = {"13": "blue", "2": "light skin"}  # patches of the ColorChecker
TEAPOT_CAMERA = Camera((0.0, 0.28, 0.95), (0.006, 0.064, 0.0), 16.5)
_BANDS = (
    "Bands, upper half: an upright matt cylinder of the same paint in these channels; "
    "lower half: in full spectra"
)
_BAND = 36  # px, each half of a band
_OF_WHITE = 0.65  # of the display's white: where a white is shown that a picture is exposed for
_TILT_DEG = 20.0  # as `stages.facing` has it: what faces a viewer a little above


@dataclass(frozen=True)
class Drawn:
    """A sheet, and the figures measured for it, by name: numbers, texts, lists, dictionaries."""

    sheet: Sheet
    measured: Mapping[str, Any]


# ------------------------------------------------------------------------------- 1: mixed light


def mixed_light(setting: Setting) -> Drawn:
    """Two teapots between window and lamp, in three channels and in six, over bands of truth."""
    lefts, wide = columns(len(WAYS))
    high = round(wide * 0.6)
    row = high + 2 * _BAND + 2 * GAP + 22
    top = MARGIN + 44
    sheet = Sheet(top + len(PAINTS) * row + MARGIN + 14)
    sheet.text(_BANDS, MARGIN, sheet.height - MARGIN - 18, size=18, colour=SOFT)
    for way, left in zip(WAYS, lefts, strict=True):
        sheet.text(WAYS[way], left, MARGIN, size=24)
    across = np.linspace(-1, 1, wide + 1)[:-1] + 1 / wide
    captured, true = setting.falling(upright(np.degrees(np.arcsin(across))))
    apart: dict[str, dict[str, Any]] = {way: {} for way in WAYS}
    several = [_teapot(setting, patch) for patch in PAINTS]
    seen = [sight(several[0])] * len(several)  # all have the same shape
    pictures = {way: setting.rendered(way, several, wide, high, sights=seen) for way in WAYS}
    for number, (patch, paint) in enumerate(PAINTS.items()):
        reflectance = np.asarray(sets.surfaces("colorchecker24")[patch])
        right = sets.xyz(true * reflectance)
        y = top + number * row
        for way, left in zip(WAYS, lefts, strict=True):
            ours = setting.matt(way, captured, reflectance)
            off = setting.apart(ours, right)
            apart[way][paint] = {"mean": float(off.mean()), "greatest": float(off.max())}
            band = np.repeat(np.stack([ours, right]), _BAND, axis=0)
            whole = np.concatenate([pictures[way][number], band])
            sheet.picture(setting.shown(whole, pictures["six"][number]), left, y)
            said = f"mean ΔE {off.mean():.1f}, greatest {off.max():.1f}"
            sheet.text(said, left, y + high + 2 * _BAND + 8, size=18, colour=SOFT)
    every = {way: _chart_apart(setting, way, captured, true) for way in WAYS}
    name = setting.primaries.name
    return Drawn(sheet, {"primaries": name, "paints": apart, "all_24_patches": every})


def _teapot(setting: Setting, patch: str) -> Scene:
    maker = Maker(setting.primaries)
    scene = scenes.teapot(maker.patch(patch, roughness=0.05), maker.patch("21", roughness=0.12))
    return replace(scene, camera=TEAPOT_CAMERA, background_level=2.0)


def _chart_apart(setting: Setting, way: str, captured, true) -> dict[str, float]:
    """CIEDE2000 of the 24 patches, matt, in light falling on them: mean and greatest."""
    off = [
        setting.apart(setting.matt(way, captured, patch), sets.xyz(true * patch))
        for patch in sets.surfaces("colorchecker24").values.T
    ]
    return {"mean": float(np.mean(off)), "greatest": float(np.max(off))}


# --------------------------------------------------------------------------------- 4: primaries

COMPARED = {"darling2011": "Darling et al. 2011: Gaussians", "signed6": "signed6: free curves"}


def primaries(_: Setting) -> Drawn:
    """The curves of the paper's primaries, and of the default's."""
    lefts, wide = columns(2)
    high = 400
    sheet = Sheet(MARGIN + 44 + high + 90)
    measured = {}
    lows, highs = zip(*(_extent(load(name).curves) for name in COMPARED), strict=True)
    for (name, heading), left in zip(COMPARED.items(), lefts, strict=True):
        known = load(name)
        relative = known.curves / known.curves.max()
        sheet.text(heading, left, MARGIN, size=24)
        axes = sheet.axes(left + 8, MARGIN + 52, wide - 16, high)
        peaks = known.peaks_nm
        fine = np.linspace(WAVELENGTHS[0], WAVELENGTHS[-1], 1401)
        for channel, curve, peak in zip(known.channels, _smooth(known, fine), peaks, strict=True):
            colour, curve = _spectral_colour(peak), curve / known.curves.max()
            axes.fill_between(fine, curve, color=colour, alpha=0.14, linewidth=0)
            axes.plot(fine, curve, color=colour, linewidth=2.2)
            axes.annotate(
                f"{channel}\n{peak:.1f}", (peak, curve.max()), (0, 7), textcoords="offset points",
                ha="center", va="bottom", fontsize=12.5, color=INK, linespacing=1.15,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlim=(380, 730), ylim=(min(lows) - 0.04, max(highs) + 0.2), yticks=[])
        axes.set_xticks(range(400, 701, 50))
        axes.tick_params(labelsize=13, colors=SOFT, length=4)
        for side in ("left", "right", "top"):
            axes.spines[side].set_visible(False)
        axes.spines["bottom"].set_color(SOFT)
        axes.set_xlabel("wavelength, nm", fontsize=13.5, color=SOFT)
        measured[name] = {"peaks_nm": peaks.tolist(), "least_over_greatest": float(relative.min())}
    return Drawn(sheet, measured)


def _extent(curves) -> tuple[float, float]:
    relative = np.asarray(curves) / np.max(curves)
    return float(relative.min()), float(relative.max())


def _smooth(known: Primaries, nm):
    """The curves (P, len(nm)) between the 36 wavelengths they are used at."""
    from scipy.interpolate import CubicSpline

    if known.curves.min() < 0:
        return CubicSpline(WAVELENGTHS, known.curves)(nm).T
    # Narrower than a spline can follow, but known to be Gaussians.
    at, between = (
        np.exp(-0.5 * ((x[:, None] - known.peaks_nm) / known.widths_nm) ** 2)
        for x in (WAVELENGTHS, nm)
    )
    return (between * known.curves.sum(axis=0) / at.sum(axis=0)).T


def _spectral_colour(nm: float):
    """Roughly how light of one wavelength looks, dark enough for lines on white."""
    at = np.exp(-0.5 * ((WAVELENGTHS - nm) / 6.0) ** 2)
    xyz = sets.xyz(at)
    rgb = np.clip(SHARP_FROM_XYZ @ xyz, 0.04 * xyz.max(), None)
    return encode(np.clip(rgb / rgb.max() * [0.72, 0.5, 0.78], 0, 1))


# ------------------------------------------------------------------------------- 5: the capture


def capture(setting: Setting) -> Drawn:
    """The sphere through both filters, and the two maps of three channels that come of it."""
    lefts, wide = columns(2)
    ball_high, map_high = round(wide * 0.9), wide // 2
    second = MARGIN + 40 + ball_high + 28
    sheet = Sheet(second + 40 + map_high + MARGIN)
    latlong, names, _ = io.read_exr(setting.result / "latlong.exr")
    maps = latlong[..., [names.index(c) for c in setting.primaries.channels]]
    for filter_, left in zip(("cyan", "yellow"), lefts, strict=True):
        photograph = _sphere(setting, filter_, ball_high, wide)
        sheet.text(f"Through the {filter_} filter", left, MARGIN, size=24)
        sheet.picture(photograph, left, MARGIN + 40)
    for first, left in zip((0, 3), lefts, strict=True):
        triple = setting.primaries.channels[first : first + 3]
        three = maps[..., first : first + 3][..., ::-1]  # the longest wavelength as red
        sheet.text(", ".join(triple), left, second, size=24)
        known = np.isfinite(three).all(axis=-1)
        at_white = 3.0 * np.array([three[..., k][known].mean() for k in range(3)])
        sheet.picture(_fitted(_bare(three, at_white), wide, map_high), left, second + 40)
    return Drawn(sheet, {"channels": list(setting.primaries.channels)})


def _sphere(setting: Setting, filter_: str, height: int, width: int):
    """The merged photograph of the sphere, its edges cut, camera RGB as if it were sRGB."""
    pixels, names, _ = io.read_exr(setting.result / "work" / f"image_{filter_}.exr")
    rgb = pixels[..., [names.index(c) for c in "RGB"]]
    tall = rgb.shape[0]
    broad = round(tall * width / height)
    if broad > rgb.shape[1]:
        broad = rgb.shape[1]
        tall = round(broad * height / width)
    y, x = (rgb.shape[0] - tall) // 2, (rgb.shape[1] - broad) // 2
    cut = rgb[y : y + tall, x : x + broad]
    at_white = np.nanpercentile(cut, 93)
    return _fitted(_bare(cut, at_white), width, height)


def _bare(rgb, at_white):
    """Light of three channels as a signal, without any regard to what colours they are."""
    return encode(shoulder(np.clip(np.nan_to_num(rgb) / at_white, 0, None)))


def _fitted(signal, width: int, height: int):
    import cv2

    smaller = signal.shape[0] > height
    method = cv2.INTER_AREA if smaller else cv2.INTER_CUBIC
    return np.clip(
        cv2.resize(np.asarray(signal, np.float32), (width, height), interpolation=method), 0, 1
    )


# ------------------------------------------------------------------------------- 6: roughness


def roughness(setting: Setting) -> Drawn:
    """A teapot of nickel and one of paint, ever rougher."""
    lefts, wide = columns(len(ROUGHNESSES))
    high = round(wide * 0.74)
    maker = Maker(setting.primaries)
    top = MARGIN + 36
    sheet = Sheet(top + 2 * (high + GAP) - GAP + MARGIN)
    camera = Camera((0.0, 0.3, 0.95), (0.012, 0.075, 0.0), 15.0)
    for alpha, left in zip(ROUGHNESSES, lefts, strict=True):
        sheet.text(f"alpha {alpha:g}", left, MARGIN, size=22)
    bodies = [
        [maker.metal("nickel", roughness=alpha) for alpha in ROUGHNESSES],
        [maker.patch("13", roughness=alpha) for alpha in ROUGHNESSES],
    ]
    several = [
        [Scene(((teapot_mesh(), body),), camera, background_level=2.5) for body in row]
        for row in bodies
    ]
    seen = [sight(several[0][0])] * len(ROUGHNESSES)
    for row, along in enumerate(several):
        pictures = setting.rendered("six", along, wide, high, sights=seen)
        for xyz, left in zip(pictures, lefts, strict=True):  # the roughest are the brightest
            sheet.picture(setting.shown(xyz, pictures[-1]), left, top + row * (high + GAP))
    return Drawn(sheet, {"alpha": list(ROUGHNESSES)})


# ------------------------------------------------------------------------------ 7: ColorChecker

FACING = {"The window": 325.0, "The lamp": 60.0}
"""Where the viewer stands, degrees from +Z towards +X, in the bundled room."""


def colorchecker(setting: Setting) -> Drawn:
    """The chart of 24 glossy spheres, facing the window and facing the lamp."""
    composition = compose("colorchecker", setting.light, setting.primaries)
    lefts, wide = columns(len(FACING))
    high = round(wide / composition.aspect)
    top = MARGIN + 44
    sheet = Sheet(top + high + 40 + MARGIN)
    measured = {}
    for (heading, azimuth), left in zip(FACING.items(), lefts, strict=True):
        (xyz,) = setting.rendered("six", [turned(composition.scene, azimuth)], wide, high)
        sheet.text(f"Facing {heading.lower()}", left, MARGIN, size=24)
        sheet.picture(setting.shown(xyz, xyz), left, top)
        captured, true = setting.falling(upright(azimuth))
        off = {way: _chart_apart(setting, way, captured, true) for way in WAYS}
        said = "mean ΔE against full spectra: " + ", ".join(
            f"{name} {off[way]['mean']:.1f}"
            for way, name in (("six", "six channels"), ("sharp", "sharpened RGB"), ("xyz", "XYZ"))
        )
        sheet.text(said, left, top + high + 10, size=18, colour=SOFT)
        measured[heading] = {"facing_deg": azimuth, **off}
    return Drawn(sheet, measured)


# -------------------------------------------------------------------------------- 8: metamers


def metamers(setting: Setting) -> Drawn:
    """Two teapots of paints that match by the lamp and part at the window."""
    composition = compose("metamers", setting.light, setting.primaries)
    ways = ("sharp", "six")
    lefts, wide = columns(2)
    high = round(wide / 1.9)
    row = 40 + high + 28
    sheet = Sheet(MARGIN + len(ways) * row + 20 + MARGIN)
    paints = composition.spectra["paints"].values.T
    lights = [light.replace("A", "lamplight") if light == "A" else "daylight"
              for light in LIGHTS.split(",")]  # fmt: skip
    measured: dict[str, Any] = {
        "facing_deg": list(composition.facing),
        "delta_e": {**composition.figures["delta_e"], "full_spectra": {}},
    }
    nearer = replace(composition.scene, camera=Camera((0.0, 0.3, 1.35), (0.0, 0.055, 0.0), 15.0))
    several = [turned(nearer, azimuth) for azimuth in composition.facing]
    first = sight(several[0])
    seen = [first.turned(azimuth - composition.facing[0]) for azimuth in composition.facing]
    pictures = {way: setting.rendered(way, several, wide, high, sights=seen) for way in ways}
    for column, (azimuth, white, left) in enumerate(
        zip(composition.facing, composition.whites, lefts, strict=True)
    ):
        side = ("match", "part")[column]
        _, true = setting.falling(upright(azimuth, _TILT_DEG))
        colours = [sets.xyz(true * paint) for paint in paints]
        apart = float(setting.apart(colours[0], colours[1], sets.xyz(true)))
        measured["delta_e"]["full_spectra"][side] = apart
        for number, way in enumerate(ways):
            y = MARGIN + number * row
            off = composition.figures["delta_e"][way][side]
            sheet.text(f"{WAYS[way]}, {lights[column]}", left, y, size=24)
            sheet.text(f"ΔE {off:.1f}", left + wide, y, size=24, align="right")
            sheet.picture(
                setting.shown(pictures[way][column], _OF_WHITE * white[None], white), left, y + 40
            )
        sheet.text(
            f"in full spectra, ΔE {apart:.1f}", left + wide, MARGIN + len(ways) * row - 12,
            size=20,
            colour=SOFT, align="right",
        )  # fmt: skip
    return Drawn(sheet, measured)
