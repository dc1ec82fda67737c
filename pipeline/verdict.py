"""What a capture's figures mean for whoever wants to use its light: RULES, at the end.

Each rule reads result.json, says what is wrong in a sentence that has the figure, why that matters
and what to do; nothing where nothing is. Its limits are stated beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from math import hypot, log
from typing import Any

from pipeline.report import shutter
from stages.mirror import ENOUGH_OF_THE_RIM

Result = Mapping[str, Any]

GOOD, LOOK, DISTRUST = GRADES = ("good", "look here", "do not trust")


@dataclass(frozen=True)
class Finding:
    """Something about a capture that its user should know.

    about   the word for it: one of the rules' names
    grade   LOOK or DISTRUST
    found   what, with its figure
    remedy  what to do about it
    """

    about: str
    grade: str
    found: str
    remedy: str


def verdict(result: Result) -> dict[str, Any]:
    """The grade of a capture, the worst of its findings, and these, the worst first."""
    findings = sorted(
        (finding for rule in RULES for finding in rule(result)),
        key=lambda f: GRADES.index(f.grade),
        reverse=True,
    )
    return {
        "grade": findings[0].grade if findings else GOOD,
        "findings": [asdict(f) for f in findings],
    }


def learnt(result: Result, step: str) -> dict[str, Mapping[str, Any]]:
    """What a step found, by what it was done for: a filter's name, or "" for the whole capture."""
    found = {}
    for name, told in result["steps"].items():
        word, _, of = name.partition(" ")
        if word == step:
            found[of] = told["learnt"]
    return found


def _grade(value: float, look: float, distrust: float) -> str | None:
    return DISTRUST if value > distrust else LOOK if value > look else None


def _worse(*grades: str | None) -> str | None:
    return max((g for g in grades if g), key=GRADES.index, default=None)


def _noise(result: Result) -> Iterator[Finding]:
    # CIEDE2000 of whites. One is what an eye sees side by side, and a diffuse white, lit from half
    # the map, ought to stay below. From one texel alone, as a mirror shows it, more is usual.
    for told in learnt(result, "normalise").values():
        noise = told["white_delta_e_noise"]
        side = max(noise["facing"], key=lambda s: _number(noise["facing"][s]))
        diffuse, texel = _number(noise["facing"][side]), _number(noise["median"])
        if grade := _worse(_grade(diffuse, 1.0, 3.0), _grade(texel, 4.0, 15.0)):
            yield Finding(
                "underexposed",
                grade,
                f"noise alone moves a white by {_told(noise['median'])} CIEDE2000 where it is lit"
                f" from one direction, and by {_told(noise['facing'][side])} where it gathers the"
                f" light of the side {side}",
                f"add longer exposures; the longest was {_longest(result)}",
            )


def _clipped(result: Result) -> Iterator[Finding]:
    # By its lower bound: a lamp that clips may be any number of times brighter.
    for view, told in learnt(result, "unwrap").items():
        for name, lost in told["lost"].items():
            if grade := _grade(lost["of_light"], 1e-4, 1e-2):
                yield Finding(
                    "clipped",
                    grade,
                    f"{' '.join(filter(None, (view, name)))}: even the shortest exposure is"
                    f" saturated over {lost['solid_angle_sr']:.2g} sr, which gives"
                    f" {lost['of_light']:.2%} of the light or more",
                    f"add shorter exposures; the shortest was {_shortest(result)}",
                )


def _shutters(result: Result) -> Iterator[Finding]:
    # Shutters stray from their tags by up to 7 %; a quarter is another exposure than it says.
    for name, told in learnt(result, "merge").items():
        ratios = [s / t for s, t in zip(told["light_solved"], told["light_tagged"], strict=True)]
        middle = sorted(ratios)[len(ratios) // 2]
        off = {f: r / middle - 1.0 for f, r in zip(told["files"], ratios, strict=True)}
        worst = max(off, key=lambda f: abs(off[f]))
        if abs(off[worst]) > 0.25:
            yield Finding(
                "shutter",
                LOOK,
                f"{name}: {worst} got {1 + off[worst]:.2f} times the light that its tag says,"
                " beside the others",
                "a lamp may flicker, or the tag be wrong: photograph with longer times, or leave"
                " the file out",
            )


def _movement(result: Result) -> Iterator[Finding]:
    for name, told in learnt(result, "merge").items():
        if grade := _grade(told["moved"], 0.002, 0.05):
            yield Finding(
                "moved",
                grade,
                f"{name}: {told['moved']:.1%} of the picture changed between its exposures",
                "see the map of what moved; photograph again where it is the sphere, or a lamp",
            )


def _rim(result: Result) -> Iterator[Finding]:
    for told in learnt(result, "locate").values():
        if told["rim_found"] is not None and told["rim_found"] < ENOUGH_OF_THE_RIM:
            yield Finding(
                "rim",
                LOOK,
                f"only {told['rim_found']:.0%} of the sphere's rim agrees with the circle found",
                _CHECK_RIM,
            )
        # Half a degree is what a near room moves directions by, too.
        doubt = _doubt_of_directions(told)
        if grade := _grade(doubt, 0.5, 2.0):
            yield Finding(
                "rim",
                grade,
                f"the sphere's rim is known so roughly that directions may be {doubt:.1f} degrees"
                " off",
                _CHECK_RIM,
            )


_CHECK_RIM = "look at sphere.png; give outline = [x, y, radius] under [sphere] if it is wrong"


def _doubt_of_directions(located: Mapping[str, Any]) -> float:
    """Standard deviation in degrees, sideways of the camera, that the rim's leaves; 0 if given."""
    sigma, moved = located["rim_sigma_px"], located["directions_move_by_degrees"]
    if sigma is None or None in sigma:
        return 0.0
    x, y, radius = sigma
    by_centre, by_radius = (moved[f"{name} +1 px"]["90 degrees"] for name in ("centre", "rim"))
    return hypot(max(x, y) * by_centre, radius * by_radius)


def _registration(result: Result) -> Iterator[Finding]:
    # Glass shifts a picture by a pixel or two; half a pixel of doubt is 1 % in the middle and
    # much at every edge.
    for told in learnt(result, "align").values():
        shifts = [(x * x + y * y) ** 0.5 for x, y in told["shifts"]]
        doubt = max(told["error_px"])
        if max(shifts) > 4.0 or doubt > 0.25:
            yield Finding(
                "sphere moved",
                DISTRUST if doubt > 1.0 or max(shifts) > 12.0 else LOOK,
                f"one filter's picture lies {max(shifts):.1f} px from the first's, known to"
                f" {doubt:.2f} px: more than glass does",
                "the sphere or the camera moved between the filters: photograph again",
            )


def _drift(result: Result) -> Iterator[Finding]:
    # Simulated captures that stood still stay below half of the first limit.
    for told in learnt(result, "drift").values():
        for name, change in told["filters"].items():
            share, overall = change["share_of_light"], change["overall_ratio"]
            if overall is not None and abs(log(overall)) > _MUCH_LOG:
                continue  # see _filters
            if grade := _grade(share, 0.005, 0.1):
                yield Finding(
                    "drift",
                    grade,
                    f"{share:.1%} of the light changed between {told['against']} and {name}, most"
                    f" of it to {change['largest_ratio']:.3g} times what it was",
                    "a cloud, a lamp, somebody's shadow: photograph again, the filters closer in"
                    " time",
                )
            elif overall is not None and abs(log(overall)) > _SOME_LOG:
                yield Finding(
                    "drift",
                    LOOK,
                    f"all light changed to {overall:.3g} times what it was between"
                    f" {told['against']} and {name}",
                    "check the tagged shutter times and apertures, and whether the light held",
                )


# Of one filter's light over what another's foretells, from all directions alike: the colours of
# rooms leave it unsure by 3 %; a quarter is another glass, or another M_S, sooner than a cloud.
_SOME_LOG, _MUCH_LOG = log(1.08), log(1.25)


def _filters(result: Result) -> Iterator[Finding]:
    for told in learnt(result, "drift").values():
        for name, change in told["filters"].items():
            overall = change["overall_ratio"]
            if overall is not None and abs(log(overall)) > _MUCH_LOG:
                yield Finding(
                    "filters",
                    DISTRUST,
                    f"{name} saw {overall:.3g} times the light that {told['against']} and the"
                    " calibration foretell, in all directions",
                    f"{_CHECK_GLASS}, and that the light held",
                )
    for told in learnt(result, "illuminants").values():
        share = told["share_of_impossible_colour"]
        if grade := _grade(share, 0.05, 0.2):
            yield Finding(
                "filters",
                grade,
                f"{share:.0%} of the light came out in colours that no light has",
                _CHECK_GLASS,
            )


_CHECK_GLASS = (
    "check which glass was on the lens, and that M_S was fitted with this camera and these filters"
)


def _calibration(result: Result) -> Iterator[Finding]:
    figures = result["calibration"]
    if figures is None:
        yield Finding(
            "calibration",
            LOOK,
            "there is no calibration: the camera's own bands were written, not light",
            "fit M_S with sixlight fit, or give the sensitivities of camera and filters",
        )
        return
    left_out = figures.get("leave_one_light_out_delta_e", {}).get("mean")
    if left_out is not None and (grade := _grade(left_out, 1.5, 4.0)):
        yield Finding(
            "calibration",
            grade,
            f"M_S is off by {left_out:.1f} CIEDE2000 in the mean, under a light it was not fitted"
            " with",
            "see the report of sixlight fit; measure again the patches and lights it names",
        )
    if changed := figures.get("changed_since"):
        yield Finding(
            "stale M_S",
            DISTRUST,
            f"M_S was fitted before {', '.join(changed)} changed",
            "run sixlight fit again",
        )


def _size(result: Result) -> Iterator[Finding]:
    # Of the rim's size radius over distance follows, which lens and sensor give too.
    for told in learnt(result, "locate").values():
        nominal = told["nominal_focal_px"]
        if nominal is None:
            continue
        off = told["focal_px"] / nominal - 1.0
        if grade := _grade(abs(off), 0.02, 0.1):
            yield Finding(
                "radius",
                grade,
                f"the sphere is seen {abs(off):.1%} {'larger' if off > 0 else 'smaller'} than its"
                " radius_mm, distance_mm and the lens make it",
                "measure radius_mm and distance_mm again, or correct focal_length_mm",
            )


def _near(result: Result) -> Iterator[Finding]:
    # Each direction is seen from the mirror's surface, up to a radius from the centre.
    if result["capture"]["room"] is None and not result["capture"]["distant"]:
        half_degree_m = result["capture"]["radius_mm"] * 1e-3 / 0.0087
        yield Finding(
            "near room",
            LOOK,
            f"what is nearer than {half_degree_m:.1f} m may be seen half a degree or more from"
            " where it is: each texel looks from the mirror, not from its centre",
            "give the walls in [room], or say distant = true there",
        )


def _number(value: float | None) -> float:
    return float("inf") if value is None else value


def _told(value: float | None) -> str:
    return "more than can be said in" if value is None else f"{value:.1f}"


def _longest(result: Result) -> str:
    return shutter(max(s["time_s"] for b in result["capture"]["brackets"] for s in b["exposures"]))


def _shortest(result: Result) -> str:
    return shutter(min(s["time_s"] for b in result["capture"]["brackets"] for s in b["exposures"]))


RULES: tuple[Callable[[Result], Iterator[Finding]], ...] = (
    _noise,
    _clipped,
    _shutters,
    _movement,
    _rim,
    _registration,
    _drift,
    _filters,
    _calibration,
    _size,
    _near,
)
