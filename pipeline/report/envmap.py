"""`report.html` of a capture: what was read, how it went, what to distrust.

Its figures are those of result.json; its pictures are drawn from the files beside that.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.look import Look, shown
from pipeline import io
from pipeline.report import figures, render
from pipeline.verdict import learnt

PICTURE_PX = 1024  # across, of photographs


def page(folder: Path, result: Mapping[str, Any]) -> str:
    """The report of a finished capture.

    folder  that `envmap` wrote to
    result  the content of its result.json
    """
    calibrated = result["calibration"] is not None
    return render(
        "envmap.html",
        title=result["name"],
        result=result,
        hero=_picture(folder / "preview_teapot.png") if calibrated else None,
        light=_light(folder, result) if calibrated else None,
        filters=list(_filters(folder, result)),
        noise=figures.photon_transfer(learnt(result, "merge")),
        geometry=list(_geometry(folder, result)),
        drift=list(_drift(folder, result)),
        views=list(_views(result)),
        calibration=figures.calibration(result["calibration"]) if calibrated else None,
    )


def _picture(path: Path) -> str | None:
    """A picture file as a data URL, no wider than PICTURE_PX; None where there is none."""
    if not path.is_file():
        return None
    jpeg = io.read_thumbnail(path, PICTURE_PX)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")


def _light(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """What came out: the latlong map as a picture, its lights, and how sure it is."""
    told = learnt(result, "illuminants")[""]
    pixels, names, header = io.read_exr(folder / "latlong.exr")
    matrix = np.array(header["xyz_from_primaries"].split(), float).reshape(3, -1)
    channels = [f"P{i + 1}" for i in range(matrix.shape[1])]

    def pick(wanted):
        return pixels[..., [names.index(name) for name in wanted]]

    xyz = pick(channels) @ matrix.T
    valid = pick(["valid"])[..., 0]
    white = np.nansum([np.multiply(x["share"], x["xyz"]) for x in told["lights"]], axis=0)
    picture = shown(xyz, Look(), white).signal
    # Variances add up as those of independent channels: an upper bound, see `assess`.
    spread = np.sqrt(pick([f"sigma.{c}" for c in channels]) ** 2 @ matrix[1] ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = spread / xyz[..., 1]
    return {
        "lights": told["lights"],
        "impossible": told["share_of_impossible_colour"],
        "map": figures.environment(picture, told["lights"]),
        "spectra": figures.spectra(folder / "illuminants.csv", told["lights"]),
        "valid": figures.valid(valid),
        "sigma": figures.sigma(relative),
        "noise": {
            view: told["white_delta_e_noise"] for view, told in learnt(result, "normalise").items()
        },
    }


def _filters(folder: Path, result: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of each filter: its exposures from the least light to the most, and what moved."""
    exposures = {b["name"]: b["exposures"] for b in result["capture"]["brackets"]}
    lost = {
        " ".join(filter(None, (view, name))): one
        for view, told in learnt(result, "unwrap").items()
        for name, one in told["lost"].items()
    }
    for name, told in learnt(result, "merge").items():
        solved, tagged = np.array(told["light_solved"]), np.array(told["light_tagged"])
        off = solved / tagged
        off /= np.median(off)
        rows = [
            {
                **shot,
                "ev": math.log2(tagged[k] / tagged.max()),
                "off": off[k] - 1.0,
                "clipped": told["clipped"][k],
            }
            for k, shot in enumerate(exposures[name])
        ]
        gain, read = told["noise_gain_and_read"][0]
        yield {
            "name": name,
            "told": told,
            "lost": lost[name],
            "rows": sorted(rows, key=lambda row: row["ev"]),
            "ladder": figures.exposures(rows),
            "electrons": 1.0 / gain if gain else None,
            "read_electrons": read / gain if gain else None,
            "moved": figures.moved(folder / _made(result, "merge", name, ".npz"))
            if told["moved"] > 0
            else None,
        }


def _geometry(folder: Path, result: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of each view: where the sphere is, and how the filters' pictures lie to each other."""
    alignments = learnt(result, "align")
    for view, sphere in learnt(result, "locate").items():
        x, y, z = sphere["centre_mm"]
        yield {
            "view": view,
            "rim": _picture(folder / _made(result, "locate", view, ".png")),
            "sphere": sphere,
            "distance_mm": math.sqrt(x * x + y * y + z * z),
            "alignment": alignments.get(view),
        }


def _views(result: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of several views: where each camera stood, and what the map has of it."""
    joined = learnt(result, "join").get("")
    for oriented in learnt(result, "orient").values():
        for name, view in oriented["views"].items():
            yield {
                "name": name,
                "stands": [row[2] for row in view["turn"]],  # its +Z in the first view's world
                **view,
                "share": joined and joined["share_of_directions"][name],
                "removed": joined and joined["removed"][name],
            }


def _drift(folder: Path, result: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for view, told in learnt(result, "drift").items():
        pixels, names, _ = io.read_exr(folder / _made(result, "drift", view, ".exr"))
        yield {"view": view, "told": told, "map": figures.drift(pixels, names)}


def _made(result: Mapping[str, Any], step: str, of: str, suffix: str) -> str:
    """The file of that kind that a step made for a filter or a view; "" is the whole capture."""
    (name,) = (
        name for name in result["steps"][f"{step} {of}".strip()]["made"] if name.endswith(suffix)
    )
    return name
