"""The few calls a notebook needs: `import pipeline`, then

    room = pipeline.envmap("sample_captures/room")
    room.values, room.sigma, room.valid          # (6, N, N, P), the same, (6, N, N)
    picture = pipeline.render(room, "teapot")    # picture.signal (H, W, 3), picture.xyz

Bad input raises `calibration.errors.InputError`, whose text is the line the command would print.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.primaries import Primaries
from pipeline import capture, compositions, fitting, io, previews, runner
from pipeline.files import header as headers
from pipeline.fitting import Fitted
from pipeline.previews import Rendered, Rendering
from pipeline.settings import Settings


@dataclass(frozen=True)
class EnvironmentMap:
    """A finished map of light.

    file       the cubemap.exr it was read from
    values     (6, N, N, P) float32, radiance from each direction in the primaries; NaN: not known
    sigma      (6, N, N, P) float32, standard deviation of that
    valid      (6, N, N) float32, 0 not known .. 1 fully known
    primaries  with the matrix to XYZ
    header     of the file: units, orientation, calibration
    result     the content of result.json beside the file; empty where there is none
    """

    file: Path
    values: NDArray[np.float32]
    sigma: NDArray[np.float32]
    valid: NDArray[np.float32]
    primaries: Primaries
    header: Mapping[str, str]
    result: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def xyz(self) -> NDArray[np.float64]:
        """Tristimulus values (6, N, N, 3) of the light from each direction."""
        xyz: NDArray[np.float64] = self.values @ self.primaries.xyz_from_primaries.T
        return xyz


def envmap(
    capture_folder: str | Path,
    out: str | Path | None = None,
    *,
    face_size: int = 0,
    force: bool = False,
    quiet: bool = True,
) -> EnvironmentMap:
    """Raw brackets to a map of light: `sixlight envmap`. What is current is not made again.

    out        output folder; None: build/<name of the capture's folder>
    face_size  texels along a cube's face; 0: as the sphere's picture has them
    raises     InputError, also where the capture has no calibration to make light of
    """
    folder = Path(capture_folder)
    loaded = capture.load(folder)
    place = Path("build") / folder.resolve().name if out is None else Path(out)
    runner.run(loaded, place, Settings(face_size=face_size), force=force, quiet=quiet)
    return load(place)


def load(envmap_folder: str | Path) -> EnvironmentMap:
    """The map in a folder that `envmap` wrote, or in a cubemap.exr."""
    given = Path(envmap_folder)
    file = given / "cubemap.exr" if given.is_dir() else given
    measured, names = io.read_measured(file, cube=True)
    header = io.read_exr(file)[2]
    told = file.parent / "result.json"
    return EnvironmentMap(
        file,
        measured.values,
        np.sqrt(measured.variance),
        measured.valid,
        headers.primaries_of(file, names, header),
        header,
        json.loads(told.read_text(encoding="utf-8")) if told.is_file() else {},
    )


def render(light: EnvironmentMap | str | Path, scene: str = "teapot", **rendering: Any) -> Rendered:
    """A scene lit by a map, headless: `sixlight preview` without its files.

    light      a map, or where one is
    scene      a name of `sixlight preview --scene`, a mesh or a scene file
    rendering  the fields of `pipeline.previews.Rendering`: width, channels, samples, look ...
    returns    its `signal` (H, W, 3) is for the look's display; `xyz` is linear
    """
    place = light.file if isinstance(light, EnvironmentMap) else Path(light)
    environment = previews.read(place)
    composition = compositions.compose(scene, environment.light, environment.primaries)
    return previews.draw(
        environment.light, environment.primaries, composition, Rendering(**rendering)
    )


def fit(
    calibration: str | Path, *, primaries: str | None = None, method: str | None = None
) -> Fitted:
    """M_S from a chart session: `sixlight fit` without its file.

    calibration  folder of chart photographs and radiance CSVs
    returns      its `transform` has the matrix, with figures; `write_transform` of
                 `calibration.transform` writes it
    """
    return fitting.from_session(Path(calibration), primaries, method, quiet=True)
