"""The mirror sphere as a camera sees it: which pixel shows which direction of the world.

The camera is a pinhole at its entrance pupil: x right, y down, z along the optical axis, and the
world point (x, y, z) at the pixel `principal_px + focal_px * (x, y) / z`, or where the lens's
distortion moves that (`stages/lens.py`). The world of the result
is that of a cubemap: the sphere's centre is the origin, +Z points from it to the entrance pupil,
+Y is the photograph's up made perpendicular to that, +X = +Y x +Z lies to the right.

Everything happens in the plane through the pupil, the sphere's centre and the point of reflection.
There, with D the distance and r the radius, a point whose normal is turned by phi from +Z is seen
at the angle alpha from the axis and shows the direction turned by psi from +Z:

    tan alpha = r sin phi / (D - r cos phi),    psi = 2 phi + alpha,    incidence = phi + alpha

from the middle, phi = 0, to the rim, where the line of sight is a tangent: sin alpha = r / D,
psi = pi - alpha. Directions beyond that, the blind cone, are hidden behind the sphere.

All that is for a distant world. In a near `Room` a direction of the result is that from the
sphere's centre to a wall, and the mirror looks there from its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import asin, atan, cos, hypot, nan, pi, radians, sin, sqrt, tan

import numpy as np
from numpy.typing import NDArray

from stages.lens import distorted, stretch, undistorted
from stages.room import Room

Array = NDArray[np.float64]

# Of a rim's sectors: where fewer agree with it, errors of a pixel are to be feared. Of the rims of
# `benchmarks.rims` that were found a pixel off, half have fewer, and of all in furnished rooms a
# fifth.
ENOUGH_OF_THE_RIM = 0.5

_PARALLAX_ROUNDS = 6  # each leaves radius / wall of the error the last has left, or less


@dataclass(frozen=True)
class Sphere:
    """Where the camera sees the sphere, and what was learnt in finding it.

    centre_mm         of the sphere, in the camera's frame
    radius_mm         of the sphere
    focal_px          focal length over pixel pitch
    principal_px      x, y where the optical axis meets the image
    yaw_deg           the result's content is turned right-handedly about +Y by this: at 90 what
                      was in +Z, towards the camera, is in +X
    rim_residual_px   robust standard deviation of the rim's sectors about the fitted one
    rim_found         share of its sectors that agree with it to .3 px, 0..1: ENOUGH_OF_THE_RIM or
                      it is in doubt; NaN where the outline was given
    nominal_focal_px  the focal length that was given, where the distance was too and so decided
    room              the walls about the sphere; None for a distant world
    turn              rotation (3, 3) from the world as this camera has it to that of the result,
                      yaw aside: to another camera's, of several about the sphere; None for its own
    rim_sigma_px      standard errors of the centre's x, y and of `rim_px`
    rim_agrees        of the rim's sectors, clockwise from the right: which agree with the rim
    blur_px           standard deviation of the photograph's blur, as the rim was measured with
    distortion        k1, k2, k3 of the lens, see `stages/lens.py`
    """

    centre_mm: tuple[float, float, float]
    radius_mm: float
    focal_px: float
    principal_px: tuple[float, float]
    yaw_deg: float = 0.0
    rim_residual_px: float = nan
    rim_found: float = nan
    nominal_focal_px: float | None = None
    room: Room | None = None
    turn: Sequence[Sequence[float]] | None = None
    rim_sigma_px: Sequence[float] = (nan, nan, nan)
    rim_agrees: Sequence[bool] = ()
    blur_px: float = nan
    distortion: Sequence[float] = (0.0, 0.0, 0.0)

    @classmethod
    def from_rim(
        cls,
        x: float,
        y: float,
        rim_px: float,
        *,
        radius_mm: float,
        principal_px: tuple[float, float],
        distance_mm: float | None = None,
        focal_px: float | None = None,
        yaw_deg: float = 0.0,
        room: Room | None = None,
        distortion: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Sphere:
        """The sphere whose centre is seen at x, y and whose rim has the size `rim_px`.

        rim_px is the radius, in px, the rim would have on the optical axis of a lens that does not
        distort: focal length times the tangent of the rim's angle from the sphere's centre. So x, y
        and rim_px are what a photograph shows, whatever lens it was taken with, and hardly depend
        on each other. Given the distance (entrance pupil to centre), the focal length follows, and
        a focal length given besides is only remembered: a tape measure is better than the number
        on a lens. Given the focal length alone, the distance follows.
        """
        nominal = None
        if distance_mm is not None:
            focal, nominal = rim_px / tan(asin(radius_mm / distance_mm)), focal_px
        else:
            assert focal_px is not None, "neither distance nor focal length"
            focal = focal_px
            distance_mm = radius_mm / sin(atan(rim_px / focal))
        seen = (x - principal_px[0]) / focal, (y - principal_px[1]) / focal
        ray = (*(float(v) for v in undistorted(seen, distortion)), 1.0)
        scale = distance_mm / sqrt(sum(v * v for v in ray))
        return cls(
            centre_mm=(ray[0] * scale, ray[1] * scale, ray[2] * scale),
            radius_mm=radius_mm,
            focal_px=float(focal),
            principal_px=principal_px,
            yaw_deg=yaw_deg,
            nominal_focal_px=nominal,
            room=room,
            distortion=distortion,
        )

    @property
    def distance_mm(self) -> float:
        """Entrance pupil to the sphere's centre."""
        return sqrt(sum(v * v for v in self.centre_mm))

    @property
    def rim_angle_rad(self) -> float:
        """Half angle of the cone of tangents; the blind cone about -Z has the same."""
        return asin(self.radius_mm / self.distance_mm)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Pixel x, y at which the sphere's centre is seen; not quite the middle of the rim."""
        x, y = self._image_of(np.asarray(self.centre_mm))
        return float(x), float(y)

    @property
    def rim_px(self) -> float:
        """Size of the rim as `from_rim` has it: its radius, were it on the optical axis."""
        return self.focal_px * tan(self.rim_angle_rad)

    @cached_property
    def world_from_camera(self) -> Array:
        """Rotation (3, 3) of directions from the camera's frame to the world's, yaw included."""
        return self._yaw @ self._turn @ self._own_from_camera

    @property
    def _own_from_camera(self) -> Array:
        """Rotation (3, 3) to the world that has +Z towards this camera."""
        z = -np.asarray(self.centre_mm) / self.distance_mm
        up = np.array([0.0, -1.0, 0.0])
        y = up - (up @ z) * z
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z])

    @property
    def _turn(self) -> Array:
        return np.eye(3) if self.turn is None else np.asarray(self.turn, np.float64)

    @property
    def towards_camera(self) -> Array:
        """Unit vector (3,) of the world, from the sphere's centre to the entrance pupil."""
        towards: Array = self._yaw @ self._turn[:, 2]
        return towards

    @property
    def _yaw(self) -> Array:
        c, s = cos(radians(self.yaw_deg)), sin(radians(self.yaw_deg))
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def with_shift(self, shift) -> Sphere:
        """The same sphere in an image whose content lies `shift` = (x, y) px further."""
        x, y = self.principal_px
        return replace(self, principal_px=(x + float(shift[0]), y + float(shift[1])))

    def direction_of(self, pixels) -> Array:
        """World directions the sphere shows.

        pixels   (..., 2) x, y
        returns  (..., 3) unit, from where the light came; NaN off the sphere
        """
        ray = self._rays(pixels)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        centre = np.asarray(self.centre_mm)
        power = self.distance_mm**2 - self.radius_mm**2  # of the pupil: near times far hit
        along = ray @ centre
        under_root = along * along - power
        hit = under_root >= 0
        root = np.sqrt(np.where(hit, under_root, np.nan))
        point = (power / (along + root))[..., None] * ray
        normal = (point - centre) / self.radius_mm
        camera = ray - 2.0 * np.sum(ray * normal, axis=-1, keepdims=True) * normal
        world: Array = camera @ self.world_from_camera.T
        if self.room is None:
            return world
        start = (self.radius_mm * 1e-3) * normal @ self.world_from_camera.T
        wall = self.room.wall(start @ self._yaw, world @ self._yaw) @ self._yaw.T
        return np.asarray(wall / np.linalg.norm(wall, axis=-1, keepdims=True))

    def pixel_of(self, directions) -> tuple[Array, NDArray[np.bool_]]:
        """Where the sphere shows world directions; the inverse of `direction_of`.

        directions  (..., 3), of any length
        returns     (..., 2) px x, y, for hidden directions the rim's nearest place, and
                    (...,) bool, whether the direction can be seen
        """
        camera = self._from_surface(directions) @ self.world_from_camera
        axis = np.asarray(self.centre_mm) / self.distance_mm
        towards = -(camera @ axis)
        across = camera + towards[..., None] * axis
        length = np.sqrt(np.einsum("...i,...i->...", across, across))
        psi = np.arctan2(length, towards)
        table_psi, table_tan = self._table
        slope = np.interp(psi, table_psi, table_tan)  # tan alpha; constant past the rim
        slope = slope / np.where(length > 0, length, 1.0)
        ray = axis + slope[..., None] * across
        return self._image_of(ray), psi <= pi - self.rim_angle_rad

    def _from_surface(self, directions) -> Array:
        """Directions (..., 3) in which the mirror sees what lies in these from its centre.

        Whoever stands on the mirror at r n sees the wall's point P in P - r n, and n follows from
        the direction in which it sees: iterated, from the wall as the centre sees it. All of it
        happens in the plane of P and the axis, on one side of the axis.
        """
        d = np.asarray(directions, np.float64)
        if self.room is None:
            return d
        radius, towards = self.radius_mm * 1e-3, self.towards_camera
        wall = self.room.wall(np.zeros(3), d @ self._yaw) @ self._yaw.T
        forward = wall @ towards
        across = wall - forward[..., None] * towards
        aside = np.linalg.norm(across, axis=-1)
        across /= np.where(aside > 0, aside, 1.0)[..., None]
        table_psi, table_tan = self._table
        x, z = aside, forward
        for _ in range(_PARALLAX_ROUNDS):
            psi = np.arctan2(x, z)
            alpha = np.arctan(np.interp(psi, table_psi, table_tan))
            phi = (np.minimum(psi, table_psi[-1]) - alpha) / 2.0
            # What lies on the other side of the axis is behind the sphere: no further than on it.
            x = np.maximum(aside - radius * np.sin(phi), 1e-9 * aside)
            z = forward - radius * np.cos(phi)
        return np.asarray(z[..., None] * towards + x[..., None] * across)

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """psi (ascending) and tan alpha from the middle to the rim.

        16385 nodes: linear interpolation between them is off by less than 1e-6 of a pixel for a
        sphere of a thousand, so the inverse counts as exact.
        """
        r, d = self.radius_mm, self.distance_mm
        phi = np.linspace(0.0, pi / 2 - self.rim_angle_rad, 16385)
        tangent = r * np.sin(phi) / (d - r * np.cos(phi))
        return 2.0 * phi + np.arctan(tangent), tangent

    def incidence_angle(self, directions) -> Array:
        """Angle of incidence (...,), rad, at which world directions (..., 3) are reflected.

        NaN in the blind cone.
        """
        d = self._from_surface(directions)
        z = self.towards_camera
        towards = d @ z
        psi = np.arctan2(np.linalg.norm(d - towards[..., None] * z, axis=-1), towards)
        table_psi, table_tan = self._table
        alpha = np.arctan(np.interp(psi, table_psi, table_tan))
        return np.where(psi <= pi - self.rim_angle_rad, (psi + alpha) / 2.0, np.nan)

    def pixels_per_radian(self, directions) -> Array:
        """How finely the photograph shows what lies in directions (..., 3), the worse way: (...,).

        Half the rim's radius in the middle, nothing at the rim, where a pixel across it shows
        ever more; along it there are always enough. 0 in the blind cone; walls count as distant.
        """
        psi, tangent = self._table
        slope = self.focal_px * np.gradient(tangent, psi)
        cosine = np.asarray(directions, np.float64) @ self.towards_camera
        length = np.linalg.norm(directions, axis=-1)
        return np.interp(np.arccos(np.clip(cosine / length, -1.0, 1.0)), psi, slope, right=0.0)

    def outline(self, count: int = 360) -> Array:
        """Points (count, 2) of the rim in the image, an ellipse; clockwise as seen, from the right.

        The rim is where the cone of tangents from the entrance pupil meets the image.
        """
        axis = np.asarray(self.centre_mm) / self.distance_mm
        down = np.array([0.0, 1.0, 0.0]) - axis[1] * axis
        down /= np.linalg.norm(down)
        right = np.cross(down, axis)
        t = np.arange(count)[:, None] * (2.0 * pi / count)
        ray = axis + tan(self.rim_angle_rad) * (np.cos(t) * right + np.sin(t) * down)
        return self._image_of(ray)

    def inside_px(self, pixels) -> Array:
        """How far (...,) inside the rim pixels (..., 2) lie, in px; negative outside.

        To first order: exact at the rim, good near it.
        """
        alpha, gradient = self._off_axis(pixels)
        return (self.rim_angle_rad - alpha) / np.linalg.norm(gradient, axis=-1)

    def outward(self, pixels) -> Array:
        """Unit vectors (..., 2) across the rim, away from the sphere, at pixels (..., 2)."""
        gradient = self._off_axis(pixels)[1]
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def _rays(self, pixels) -> Array:
        offset = np.asarray(pixels, np.float64) - np.asarray(self.principal_px)
        if any(self.distortion):
            offset = self.focal_px * undistorted(offset / self.focal_px, self.distortion)
        return np.concatenate([offset, np.full((*offset.shape[:-1], 1), self.focal_px)], axis=-1)

    def _image_of(self, rays: Array) -> Array:
        """Pixels (..., 2) at which rays (..., 3) from the entrance pupil, of any length, arrive."""
        ideal = rays[..., :2] / rays[..., 2:]
        return np.asarray(self.principal_px) + self.focal_px * distorted(ideal, self.distortion)

    def _off_axis(self, pixels) -> tuple[Array, Array]:
        """Angle (...,) of pixels (..., 2) from the sphere's centre, and its gradient per px."""
        ray = self._rays(pixels)
        axis = np.asarray(self.centre_mm) / self.distance_mm
        length = np.linalg.norm(ray, axis=-1)
        sine = np.linalg.norm(np.cross(ray, axis), axis=-1) / length
        cosine = (ray @ axis) / length
        downhill = (axis[:2] - (cosine / length)[..., None] * ray[..., :2]) / length[..., None]
        if any(self.distortion):
            moved = stretch(ray[..., :2] / self.focal_px, self.distortion)
            downhill = np.linalg.solve(moved, downhill[..., None])[..., 0]
        return np.arctan2(sine, cosine), -downhill / np.maximum(sine, 1e-12)[..., None]


def rim_from_circle(x: float, y: float, radius_px: float, sphere_at) -> tuple[float, float, float]:
    """The `from_rim` numbers of the sphere whose rim is nearest a drawn circle.

    sphere_at  (x, y, rim_px) -> Sphere
    returns    x, y, rim_px

    A rim is an ellipse a little larger and further out than the size and the image of its sphere,
    by some 1e-3 of it for long lenses; a few rounds of correction meet the circle.
    """
    rim = np.array([x, y, radius_px])
    for _ in range(20):
        outline = sphere_at(*rim).outline(72)
        middle = (outline.max(axis=0) + outline.min(axis=0)) / 2.0
        radius = np.mean([hypot(*p) for p in outline - middle])
        step = np.array([x - middle[0], y - middle[1], radius_px - radius])
        rim += step
        if np.abs(step).max() < 1e-6:
            break
    return float(rim[0]), float(rim[1]), float(rim[2])
