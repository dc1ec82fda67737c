"""The page about the figures, its numbers those that were measured when they were drawn."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import fault

MEASURED = "figures.json"

TITLES = {
    "mixed_light": "Figure 1: two teapots in mixed light",
    "primaries": "Figure 4: the primaries",
    "capture": "Figure 5: the sphere, and the maps made from it",
    "roughness": "Figure 6: roughness",
    "colorchecker": "Figure 7: a ColorChecker of glossy spheres",
    "metamers": "Figure 8: metamers",
    "errors": "Errors, pixel by pixel",
}

_HEAD = """\
# Figures

The figures of *Real-Time Multispectral Rendering with Complex Illumination*, by its numbers, made
from the bundled capture; and maps of errors, which it did not have. `make figures` draws them and
writes this page, numbers and all; `python -m benchmarks.figures --only metamers` draws one.
`sixlight preview` shows the same scenes in light of your own: [scenes.md](scenes.md).

Three channels are shown at their best: the same map brought to XYZ or to sharpened RGB, the same
shader, the same exposure. dE is CIEDE2000 after adaptation (CAT02) from the white of the room, or
of its side that is looked at; 1 is about what an eye can tell apart, side by side.
"""

Measured = Mapping[str, Any]
_WAYS = {"six": "six channels", "sharp": "sharpened RGB", "xyz": "XYZ"}


def file_of(name: str) -> str:
    """The picture's file name."""
    return f"figure_{name}.png"


def read(path: Path) -> dict[str, Any]:
    """What was measured, by figure; nothing where there is no such file yet."""
    if not path.exists():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError):
        raise fault("not what `make figures` writes", "a JSON object", "delete it", path) from None


def written(measured: Mapping[str, Measured]) -> str:
    """The page as Markdown, of the figures that were drawn.

    measured  by figure, as `read` gives it
    """
    parts = [_HEAD]
    for name, title in TITLES.items():
        parts.append(f"## {title}\n")
        if name in measured:
            parts.append(f"![{title}](images/{file_of(name)})\n")
            parts.append(_CAPTIONS[name](measured[name]))
        elif name == "errors":
            parts.append("Left out: Mitsuba, of the extra `bench`, was not there to draw them.\n")
        else:
            parts.append(f"Not drawn yet: `python -m benchmarks.figures --only {name}`.\n")
    return "\n".join(parts)


def _mixed_light(m: Measured) -> str:
    rows = {paint: [m["paints"][way][paint] for way in _WAYS] for paint in m["paints"]["six"]}
    rows["all 24 of the ColorChecker"] = [m["all_24_patches"][way] for way in _WAYS]
    return f"""\
Daylight comes through a window on the left, tungsten light from a lamp on the right; both mirror in
the glaze. Each band is an upright matt cylinder of the teapot's paint: its upper half in these
channels under the captured map, its lower half in full spectra under the true light. Look for the
seam at the right, where lamplight falls. In XYZ the blue turns purple and the skin tone goes
yellow, in sharpened RGB a little less; in six channels, here `{m["primaries"]}`, it is hard to
find. The difference is that of a whole capture: camera, calibration, sphere and channels.

{_table("dE of the bands: mean, greatest", _WAYS.values(), _cells(rows, "greatest"))}"""


def _primaries(m: Measured) -> str:
    return f"""\
Left the paper's Gaussians (`darling2011`), right the default (`signed6`), free curves fitted to
more lights and surfaces; [colour.md](colour.md) has what either gets wrong. Above each curve is the
wavelength of its peak, nm. Each has the area of its neighbours, so narrow ones are tall. The free
curves go below zero, by {-m["signed6"]["least_over_greatest"]:.0%} of the highest peak: light in a
channel may then be negative, and has to be kept.
"""


def _capture(m: Measured) -> str:
    first, second = (", ".join(m["channels"][k : k + 3]) for k in (0, 3))
    return f"""\
Above, the merged photographs through both filters, in the camera's own red, green and blue,
unbalanced. Below, the two maps of three channels that a renderer is given, {first} and
{second}, the longest wavelength shown as red, each channel relative to its mean. The
carpet is red in the second map alone: the first knows nothing of light beyond green. Black is what
the sphere cannot show, behind itself and behind its stand.
"""


def _roughness(m: Measured) -> str:
    return f"""\
Nickel, and a blue paint under a clear gloss, in six channels; alpha of the bounded Ward BRDF from
{m["alpha"][0]:g} to {m["alpha"][-1]:g}. Window, lamp and carpet mirror at the left, and
spread until only their colour remains. Look for grain, or for single bright pixels on spout and
handle: there should be none.
"""


def _colorchecker(m: Measured) -> str:
    rows = {
        f"{side}, at {found['facing_deg']:g} degrees": [found[way] for way in _WAYS]
        for side, found in m.items()
    }
    said = "dE of 24 matt patches that face the viewer: mean, greatest"
    return f"""\
The same chart with its face to the window and with its face to the lamp, shown to an eye adapted to
the room as a whole. Three channels take what daylight makes of a paint for the paint: by the window
they are right, by the lamp they are not.

{_table(said, _WAYS.values(), _cells(rows, "greatest"))}"""


def _metamers(m: Measured) -> str:
    names = {**_WAYS, "full_spectra": "full spectra, true light"}
    sides = {"lamplight": "match", "daylight": "part"}
    rows = {
        said: [f"{m['delta_e'][way][side]:.1f}" for side in sides.values()]
        for way, said in names.items()
    }
    return f"""\
Two paints that the program finds for a map: here alike by lamplight, far apart by daylight. In
three channels they differ by lamplight too, where nobody in the room would see a difference; in six
they match. The viewer is adapted to the light of the side he looks at.

{_table("dE from teapot to teapot, matt, facing the viewer", sides, rows)}"""


def _errors(m: Measured) -> str:
    return f"""\
The left column is rendered in 36 wavelengths by Mitsuba 3, which shares no shading code with the
others; the rest is how far renders in few channels are from it. All are given the true light, so
that a capture's errors are not in it. *Channels alone*: shading is exact, and the same for all.
*Everything*: the shaders' own pictures, against a truth in which light also goes from thing to
thing. The shaders leave that light out: what is bright under every way alike, between the spheres
and around the teapot's foot, is its lack.

{_table("dE: mean, 95th percentile", _WAYS.values(), _cells(_by_way(m), "p95"))}"""


def _by_way(m: Measured) -> dict[str, list[Measured]]:
    return {what: [found[way] for way in _WAYS] for what, found in m.items()}


_CAPTIONS: dict[str, Callable[[Measured], str]] = {
    "mixed_light": _mixed_light,
    "primaries": _primaries,
    "capture": _capture,
    "roughness": _roughness,
    "colorchecker": _colorchecker,
    "metamers": _metamers,
    "errors": _errors,
}


def _cells(rows: Mapping[str, Iterable[Measured]], most: str) -> dict[str, list[str]]:
    """Mean and greatest, or another, of each."""
    return {said: [f"{v['mean']:.2f}, {v[most]:.2f}" for v in row] for said, row in rows.items()}


def _table(corner: str, heads: Iterable[str], rows: Mapping[str, Iterable[str]]) -> str:
    heads = list(heads)
    lines = [(corner, *heads), ["---"] * (len(heads) + 1), *((k, *row) for k, row in rows.items())]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
