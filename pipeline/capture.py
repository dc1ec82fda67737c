"""A folder of photographs and its capture.toml, read and checked into a Capture.

Everything in capture.toml has a default or comes from the files. Whatever is wrong is found here,
all of it, before anything is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot
from pathlib import Path

from calibration import metals, primaries, spectra
from calibration.errors import InputError, Problem, fault
from calibration.fit import fit
from calibration.training import computed
from calibration.transform import Transform, matched, read_transform
from pipeline import defaults, finished, io, masks, photographs
from pipeline.files.tables import Table, read_toml
from pipeline.photographs import Filter, OfSensor
from stages import lens
from stages.mask import Mask
from stages.merge import Known
from stages.orient import Place
from stages.room import Room

_DEFAULT_MATERIAL = "stainless steel"  # what the paper's sphere and most gazing balls are made of


@dataclass(frozen=True)
class SphereSpec:
    """What is known of the mirror sphere before looking; see INTERFACE's [sphere].

    radius_mm, distance_mm   the latter None where focal_px is to give it
    material                 a name of calibration.metals, or a CSV of n and k
    reflectance              near normal: CSV of a measured curve, or a luminous one; or None
    outline                  x, y, radius in px, or None to find it
    """

    radius_mm: float
    distance_mm: float | None
    material: str | Path
    reflectance: Path | float | None
    outline: tuple[float, float, float] | None


@dataclass(frozen=True)
class Calibration:
    """Where M_S comes from: a file of `sixlight fit`, or the sensitivities of camera and filters.

    primaries  the set wanted, a name or a folder; None for the transform's own
    """

    transform: Path | None = None
    camera: Path | None = None
    filters: Path | None = None
    primaries: str | Path | None = None


@dataclass(frozen=True)
class View:
    """One of several camera positions about the sphere; see INTERFACE's [[view]].

    place  where the camera roughly stands, from the first view's; None where that is not known
    """

    name: str
    filters: tuple[Filter, ...]
    sphere: SphereSpec
    focal_px: float | None
    mask: Mask
    place: Place | None


@dataclass(frozen=True)
class Capture:
    """A checked capture. Reading it has opened every file's header, and written nothing.

    Of several views, `filters`, `sphere`, `focal_px` and `mask` are the first one's, and `views`
    has all of them; of one it is empty.
    """

    folder: Path
    name: str
    filters: tuple[Filter, ...]
    sphere: SphereSpec
    focal_px: float | None
    room: Room | None
    calibration: Calibration
    yaw_deg: float
    known: Known
    notes: tuple[str, ...]
    of_sensor: OfSensor
    distant: bool = False
    distortion: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mask: Mask = field(default_factory=Mask)
    views: tuple[View, ...] = ()
    brackets_before: int = 0
    seen: finished.Seen = field(default_factory=dict, compare=False)

    @property
    def shots(self) -> tuple[io.Shot, ...]:
        return tuple(shot for _, f in self.brackets for shot in f.shots)

    @property
    def brackets(self) -> tuple[tuple[str, Filter], ...]:
        """What each bracket is called, and its photographs: a filter's, or a view's filter's."""
        if not self.views:
            return tuple((f.name, f) for f in self.filters)
        return tuple((f"{view.name} {f.name}", f) for view in self.views for f in view.filters)

    def of_view(self, name: str) -> Capture:
        """The capture as if it had that view alone; `brackets_before` counts those of others."""
        (number,) = (i for i, view in enumerate(self.views) if view.name == name)
        view = self.views[number]
        return replace(
            self,
            filters=view.filters,
            sphere=view.sphere,
            focal_px=view.focal_px,
            mask=view.mask,
            views=(),
            brackets_before=sum(len(v.filters) for v in self.views[:number]),
        )

    @property
    def curves(self) -> tuple[Path, ...]:
        """Files, and folders, of the calibration and the sphere's metal, as capture.toml names."""
        c, s = self.calibration, self.sphere
        named = c.transform, c.camera, c.filters, c.primaries, s.material, s.reflectance
        return tuple(path for path in named if isinstance(path, Path))

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the camera's bands, in order: cyan.R cyan.G cyan.B yellow.R ..."""
        return tuple(f"{f.name}.{c}" for f in self.filters for c in "RGB")

    @cached_property
    def primaries(self) -> primaries.Primaries | None:
        """The set the light is wanted in; None without a calibration."""
        c = self.calibration
        if c.primaries is not None:
            return primaries.load(c.primaries)
        if c.transform is not None:
            return _primaries_of(c.transform)
        return primaries.load() if c.camera is not None else None

    @cached_property
    def transform(self) -> Transform | None:
        """M_S, read or fitted from known sensitivities; None without a calibration."""
        c = self.calibration
        if self.primaries is None:
            return None
        if c.transform is not None:
            try:
                return matched(read_transform(c.transform), self.bands, self.primaries)
            except InputError as error:
                raise error.at(c.transform) from None
        assert c.camera is not None
        assert c.filters is not None
        camera = spectra.read_spectra(c.camera, "power")
        filters = spectra.read_spectra(c.filters, "fraction")
        try:
            names = [f.name for f in self.filters]
            return fit(computed(camera, filters, filter_names=names), self.primaries)
        except InputError as error:
            raise error.at(c.filters) from None


def _primaries_of(transform: Path) -> primaries.Primaries:
    """The named set a transform was fitted to."""
    name = read_transform(transform).primaries
    if name not in primaries.NAMES:
        raise fault(
            f"the primaries {name!r} are not a named set",
            ", ".join(primaries.NAMES),
            'give their folder as primaries = "FOLDER" under [calibration]',
            transform,
        )
    return primaries.load(name)


def load(folder: Path) -> Capture:
    """Reads and checks a capture; InputError lists everything wrong with it."""
    folder = Path(folder)
    photographs.check_folder(folder)
    file = folder / "capture.toml"
    problems: list[Problem] = []
    shared = defaults.above(folder)
    seen = finished.see([folder, *shared])  # before anything is read
    own = read_toml(file) if file.is_file() else {}
    content, origins = defaults.under(own, file, shared, problems)
    root = Table(content, problems, file, origins=origins)

    name = root.text("name", folder.resolve().name) or folder.resolve().name
    camera = root.table("camera")
    optics = {
        "focal_length_mm": camera.number("focal_length_mm", "mm", low=1, high=1e5),
        "pixel_pitch_um": camera.number("pixel_pitch_um", "um", low=0.1, high=1000),
    }
    known = _known(root, camera)
    positions = _positions(root, folder, camera, problems)
    filters = (
        positions[0].filters if positions else photographs.find(folder, root, camera, problems)
    )
    shots = [shot for f in filters for shot in f.shots]
    every = [f for position in positions for f in position.filters] or filters
    of_sensor = photographs.find_of_sensor(folder, filters, camera, problems)
    notes = [
        *defaults.told(origins, folder),
        *photographs.notes_of([shot for f in every for shot in f.shots]),
        *photographs.changes(filters),
        *_changes_of(positions[1:]),
        *photographs.notes_of_sensor(of_sensor, filters),
    ]
    focal_px = _focal_px(shots, optics["focal_length_mm"], optics["pixel_pitch_um"])
    distortion = _distortion(camera, focal_px, shots)
    mask = Mask()
    if "mask" in root.content:
        mask = masks.read(root.table("mask"), shots[0].size if shots else None)
    sphere = _sphere(root.table("sphere"), focal_px, shots, problems, notes)
    yaw = root.table("orientation")
    yaw_deg = yaw.number("yaw_deg", "degrees", low=-360, high=360) or 0.0
    room, distant = _room(root.table("room"), sphere) if "room" in root.content else (None, False)
    calibration = _calibration(root.table("calibration"))
    views = _views(positions, sphere, optics, mask, problems)
    if views and calibration == Calibration():
        notes.append(
            "no calibration: the views are brought into one world, but not joined; each one's bands"
            " are in work/cubemap_bands_NAME.exr"
        )
    for table in (root, camera, yaw):
        table.nothing_else()

    capture = Capture(
        folder,
        name,
        filters,
        sphere if not views else views[0].sphere,
        focal_px,
        room,
        calibration,
        yaw_deg,
        known,
        tuple(notes),
        of_sensor,
        distant,
        distortion,
        mask if not views else views[0].mask,
        views if len(views) > 1 else (),
    )
    capture.seen.update(seen | finished.see(capture.curves))
    if not problems:  # M_S is matched to the bands, so the photographs must be right first
        _collect(problems, lambda: capture.transform)
    if problems:
        raise InputError(list(dict.fromkeys(problems)))
    return capture


@dataclass(frozen=True)
class _Position:
    """A [[view]] with its photographs."""

    name: str
    table: Table
    filters: tuple[Filter, ...]


def _positions(
    root: Table, folder: Path, camera: Table, problems: list[Problem]
) -> list[_Position]:
    """The [[view]]s, each with photographs of the same filters by one camera."""
    found: list[_Position] = []
    tables = root.tables("view")
    if tables and root.tables("filter"):
        expected = "each [[filter]] under a view, as [[view.filter]]"
        root.wrong("filter", "given beside [[view]]", expected, "move it there")
    for number, table in enumerate(tables, 1):
        name = table.text("name", f"view{number}") or f"view{number}"
        if not all(c.isalnum() or c in "-_" for c in name):
            expected = "letters, digits, hyphens and underscores"
            table.wrong("name", repr(name), expected, "rename it")
            continue
        if name in (p.name for p in found):
            table.wrong("name", f"{name!r} again", "each view once", "merge or rename them")
            continue
        place = folder
        if "filter" not in table.content:
            place = folder / name
            if not place.is_dir():
                expected = f"[[view.filter]] tables, or a folder {name}/ with one a filter"
                table.wrong("filter", "missing", expected, "add them")
                continue
        with table.noting(""):
            filters = photographs.find(place, table, camera, problems)
            found.append(_Position(name, table, filters))
    for other in found[1:]:
        mine, first = ([f.name for f in p.filters] for p in (other, found[0]))
        if mine != first:
            expected = f"{', '.join(first)}, as of {found[0].name!r}, in that order"
            other.table.wrong("filter", ", ".join(mine) or "nothing", expected, "correct it")
        one = [shot for p in (found[0], other) for f in p.filters for shot in f.shots[:1]]
        photographs.check_alike(one, problems)
    return found


def _changes_of(positions: Sequence[_Position]) -> list[str]:
    """What the camera did not hold within brackets of further views."""
    return [f"{p.name} {note}" for p in positions for note in photographs.changes(p.filters)]


def _views(
    positions: Sequence[_Position], sphere: SphereSpec, optics, mask: Mask, problems: list[Problem]
) -> tuple[View, ...]:
    """The views with what each says of its own; all of it read, wrong or not."""
    views = []
    for position in positions:
        table = position.table
        shots = [shot for f in position.filters for shot in f.shots]
        distance = table.number("distance_mm", "mm", low=1, high=1e6) or sphere.distance_mm
        outline = table.numbers("outline", "px: x, y, radius", 3)
        focal_px = _focal_px(shots, optics["focal_length_mm"], optics["pixel_pitch_um"])
        if "distance_mm" in table.content and distance and distance <= 1.05 * sphere.radius_mm:
            expected = f"well above radius_mm {sphere.radius_mm:g}"
            table.wrong("distance_mm", f"{distance:g}", expected, "correct it")
        if outline is not None:
            _check_outline(table, outline, shots)
        elif sphere.outline is not None and len(positions) > 1:
            expected = "its own in each [[view]], as the sphere lies elsewhere in each"
            table.wrong("outline", "given under [sphere]", expected, "move it there")
        yaw = table.number("yaw_deg", "degrees", low=-360, high=360)
        pitch = table.number("pitch_deg", "degrees", low=-90, high=90)
        place = None if yaw is None and pitch is None else Place(yaw or 0.0, pitch or 0.0)
        if position is positions[0] and (yaw or pitch):
            expected = "0, or nothing: the others' places are counted from it"
            table.wrong("yaw_deg", f"{yaw or 0:g}, pitch_deg {pitch or 0:g}", expected, "remove it")
        of_mask = table.table("mask")
        own = mask
        if "mask" in table.content:
            own = masks.read(of_mask, shots[0].size if shots else None)
        table.nothing_else()
        spec = replace(
            sphere,
            distance_mm=distance,
            outline=(outline[0], outline[1], outline[2]) if outline else sphere.outline,
        )
        views.append(View(position.name, position.filters, spec, focal_px, own, place))
    return tuple(views)


def _check_outline(table: Table, outline, shots) -> None:
    """A circle must lie in the photographs."""
    if not shots:
        return
    x, y, r = outline
    height, width = shots[0].size
    if x - r < 0 or y - r < 0 or x + r > width or y + r > height:
        expected = f"a circle inside the {width} x {height} photograph"
        table.wrong("outline", repr(list(outline)), expected, "correct it or photograph again")


def _collect(problems: list[Problem], check: Callable[[], object]) -> None:
    try:
        check()
    except InputError as error:
        problems.extend(error.problems)


def _known(root: Table, camera: Table) -> Known:
    """What the user says of the sensor: [camera] saturation_level, and a [[noise]] an ISO."""
    noise = {}
    for table in root.tables("noise"):
        iso = table.number("iso", "ISO", low=1, high=1e7)
        electrons = table.number("full_scale_electrons", "electrons", low=10, high=1e8)
        read = table.number("read_electrons", "electrons", low=0, high=1e4)
        prnu = table.number("prnu", "share of the signal", low=0, high=0.2)
        table.nothing_else()
        for key in ("iso", "full_scale_electrons", "read_electrons"):
            if key not in table.content:
                table.wrong(key, "missing", "a number", "add it")
        if iso is not None and electrons is not None and read is not None:
            noise[iso] = 1 / electrons, read / electrons, prnu
    return Known(noise, camera.number("saturation_level", "raw steps", low=1, high=65535))


def _focal_px(shots, focal_length_mm, pixel_pitch_um) -> float | None:
    if shots:
        focal_length_mm = focal_length_mm or shots[0].focal_length_mm
        pixel_pitch_um = pixel_pitch_um or shots[0].pixel_pitch_um
    if focal_length_mm is None or pixel_pitch_um is None:
        return None
    return focal_length_mm * 1000.0 / pixel_pitch_um


def _distortion(camera: Table, focal_px, shots) -> tuple[float, float, float]:
    """k1, k2, k3 of [camera]; none where they are not given."""
    k = camera.vector("distortion", "k1, k2, k3 as OpenCV has them") or (0.0, 0.0, 0.0)
    if focal_px is not None and shots:
        corner = 0.5 * hypot(*shots[0].size) / focal_px
        if lens.reach(k) < corner:
            camera.wrong(
                "distortion",
                f"{list(k)}, by which the picture folds back {lens.reach(k):.2g} focal lengths from"
                " its middle",
                f"k1, k2, k3 of a lens that shows corners {corner:.2g} out",
                "correct them: r is in units of the focal length, from undistorted to distorted",
            )
    return k


def _sphere(table: Table, focal_px, shots, problems, notes) -> SphereSpec:
    radius = table.number("radius_mm", "mm", low=0.1, high=1e5)
    distance = table.number("distance_mm", "mm", low=1, high=1e6)
    outline = table.numbers("outline", "px: x, y, radius", 3)
    reflectance = _reflectance(table)
    text = table.text("material", _DEFAULT_MATERIAL) or _DEFAULT_MATERIAL
    material: str | Path = text
    if text.lower().endswith(".csv"):
        material = table.path("material") or _DEFAULT_MATERIAL
    elif text not in metals.MATERIALS:
        known = ", ".join(metals.MATERIALS)
        table.wrong("material", repr(text), f"one of {known}, or a CSV of n and k", "correct it")
        material = _DEFAULT_MATERIAL
    if "material" not in table.content and "reflectance" not in table.content:
        notes.append(f"no sphere material given: {_DEFAULT_MATERIAL} is assumed")
    table.nothing_else()
    if "distance_mm" in table.content and "radius_mm" not in table.content:
        # Directions depend on distance / radius: one without the other says nothing. With
        # neither, the lens gives that ratio, and the radius is only a scale that nothing uses.
        table.wrong("radius_mm", "missing", "the sphere's radius in mm", "measure it and add it")
    if distance is None and "distance_mm" not in table.content and focal_px is None:
        table.wrong(
            "distance_mm",
            "missing, and the lens is not known either",
            "the distance from the lens's entrance pupil to the sphere's centre in mm",
            "add it, or focal_length_mm and pixel_pitch_um under [camera]",
        )
    if radius is not None and distance is not None and distance <= 1.05 * radius:
        table.wrong(
            "distance_mm", f"{distance:g}", f"well above radius_mm {radius:g}", "correct it"
        )
    if outline is not None:
        _check_outline(table, outline, shots)
    place = (outline[0], outline[1], outline[2]) if outline else None
    try:
        metals.of_sphere(material, reflectance, [0.0])
    except InputError as error:  # of a CSV, which it names, or of the number
        problems.extend(error.at(table.file_of("reflectance")).problems)
    return SphereSpec(radius or 50.0, distance, material, reflectance, place)


def _room(table: Table, sphere: SphereSpec) -> tuple[Room | None, bool]:
    """The walls about the sphere, where given, and whether all is said to be far away."""
    distant = table.flag("distant")
    size = table.vector("size_m", "m: width, height, depth")
    place = table.vector("sphere_m", "m from the left wall, the floor, the wall behind the sphere")
    camera = table.vector("camera_m", "m, likewise")
    for key in ("size_m", "sphere_m"):
        if distant and key in table.content:
            table.wrong(key, "given beside distant = true", "one or the other", "remove one")
        elif not distant and key not in table.content:
            expected = "[x, y, z] in m, or distant = true"
            table.wrong(key, "missing", expected, "measure it and add it, or remove [room]")
    table.nothing_else()
    if distant or size is None or place is None:
        return None, distant
    margin = sphere.radius_mm * 1e-3
    if not all(margin < p < s - margin for p, s in zip(place, size, strict=True)):
        expected = f"the whole sphere inside size_m {list(size)}"
        table.wrong("sphere_m", repr(list(place)), expected, "correct one of them")
        return None, False
    if camera is not None and not all(0.0 <= c <= s for c, s in zip(camera, size, strict=True)):
        expected = f"a place inside size_m {list(size)}"
        table.wrong("camera_m", repr(list(camera)), expected, "correct one of them")
        return None, False
    if camera is not None and not camera[2] - place[2] > 2.0 * margin:
        expected = f"its third number above {place[2] + 2.0 * margin:g}: z runs to the camera"
        table.wrong("camera_m", repr(list(camera)), expected, "correct it, or leave it out")
        return None, False
    return Room(size, place, camera), False


def _calibration(table: Table) -> Calibration:
    named = table.text("primaries")
    wanted: str | Path | None = named
    if named is not None and named not in primaries.NAMES:
        wanted = table.inside("primaries", named)
        if wanted is not None and not wanted.is_dir():
            known = ", ".join(primaries.NAMES)
            expected = f"one of {known}, or a folder of the capture's"
            table.wrong("primaries", repr(named), expected, "correct it")
            wanted = None
    calibration = Calibration(
        table.path("transform"), table.path("camera"), table.path("filters"), wanted
    )
    table.nothing_else()
    content = table.content
    if "transform" in content and ("camera" in content or "filters" in content):
        table.wrong(
            "transform", "given beside camera and filters", "one or the other", "remove one"
        )
    elif ("camera" in content) != ("filters" in content):
        have, lack = ("camera", "filters") if "camera" in content else ("filters", "camera")
        table.wrong(have, f"given without {lack}", "both", f"add {lack}, a CSV of its spectra")
    return calibration


def _reflectance(table: Table) -> Path | float | None:
    if isinstance(table.content.get("reflectance"), str):
        return table.path("reflectance")
    return table.number(
        "reflectance", "shares of the light, or the name of a CSV", low=0.01, high=1
    )
