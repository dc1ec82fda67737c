"""The camera that photographs the simulated scenes: filter, lens, sensor, converter.

From absolute spectral radiance to the raw samples a camera would write. The sensitivities are
the Nikon D5100's as measured by NPL (colour-science); the two filters are smooth curves of our
own, shaped like the glasses BG39 (cyan) and GG475 (yellow). Everything else is a plain model of
a sensor: photo-electrons with shot noise, pixels of slightly unequal gain, hot pixels, read noise,
a converter with a black level and a saturation level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.spectra import WAVELENGTHS
from pipeline.simulate.materials import FINE, colour_science

FILTERS = ("cyan", "yellow")

# Where each filter puts the image, px (x, y): content at p through no filter is at p + shift. The
# yellow glass is a little thicker and not quite square to the axis.
FILTER_SHIFTS = {"cyan": (0.0, 0.0), "yellow": (0.75, -0.4)}

# True times are 2^(k/3) s; cameras write these round numbers. (seconds as a fraction)
_NOMINAL = {
    **dict(zip(range(-36, -5), [(1, n) for n in (
        4000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125,
        100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4)], strict=True)),
    **dict(zip(range(-5, 16), [
        (3, 10), (4, 10), (5, 10), (6, 10), (8, 10), (1, 1), (13, 10), (16, 10), (2, 1), (25, 10),
        (3, 1), (4, 1), (5, 1), (6, 1), (8, 1), (10, 1), (13, 1), (15, 1), (20, 1), (25, 1),
        (30, 1)], strict=True)),
}  # fmt: skip


@dataclass(frozen=True)
class Shutter:
    """A shutter setting: `thirds` thirds of a stop from one second, longer where positive."""

    thirds: int

    @property
    def time_s(self) -> float:
        """How long the shutter really is open."""
        return 2.0 ** (self.thirds / 3)

    @property
    def tag(self) -> tuple[int, int]:
        """The time the camera writes, as a fraction of seconds."""
        return _NOMINAL[self.thirds]


# 1/1024 s to 10.08 s in steps of 5/3 stops; tagged 1/1000 ... 1/30 (7 % off), 0.3 (5 %) ... 10.
BRACKET = tuple(Shutter(k) for k in range(-30, 11, 5))


@dataclass(frozen=True)
class Camera:
    """The camera's constants.

    width, height       px of a photograph
    focal_length_mm     of the lens; at infinity, and the image distance (a pinhole's, no breathing)
    f_number, iso       as set and as tagged
    pixel_pitch_um      side of a square pixel
    black_level         raw value of no light
    saturation_level    raw value of full scale
    full_well           photo-electrons from black to saturation
    read_noise          standard deviation, electrons
    prnu                standard deviation of the pixels' gains
    blur_px             standard deviation of the lens's point spread
    peak_efficiency     photo-electrons per photon at the green channel's peak, 530 nm
    pattern_seed        of gains and hot pixels: the same sensor in every photograph
    """

    width: int = 1024
    height: int = 920
    focal_length_mm: float = 100.0
    f_number: float = 16.0
    iso: int = 100
    pixel_pitch_um: float = 8.0
    black_level: int = 600
    saturation_level: int = 15520
    full_well: float = 40000.0
    read_noise: float = 6.0
    prnu: float = 0.004
    blur_px: float = 0.5
    peak_efficiency: float = 0.5
    pattern_seed: int = 5100

    @classmethod
    def of_width(cls, width: int) -> Camera:
        """The same sensor, its pixels larger and fewer, or smaller and more."""
        usual = cls()
        larger = usual.width / width
        return cls(
            width=width,
            height=2 * round(usual.height / larger / 2),
            pixel_pitch_um=usual.pixel_pitch_um * larger,
            full_well=usual.full_well * larger**2,
        )

    @property
    def focal_px(self) -> float:
        return self.focal_length_mm * 1000.0 / self.pixel_pitch_um

    @property
    def electrons_per_step(self) -> float:
        return self.full_well / (self.saturation_level - self.black_level)


def transmittance(name: str, wavelengths=FINE) -> NDArray[np.float64]:
    """Transmittance of a filter at wavelengths in nm."""
    w = np.asarray(wavelengths, np.float64)
    if name == "cyan":  # passes blue and green, cuts red slowly
        return 0.92 / (1 + np.exp((w - 590.0) / 14.0)) / (1 + np.exp((360.0 - w) / 10.0))
    assert name == "yellow", name  # a sharp long pass
    return 0.91 / (1 + np.exp((475.0 - w) / 6.0))


def responses(camera: Camera, filter_name: str) -> NDArray[np.float64]:
    """Photo-electrons per second and pixel (71, 3) of unit radiance in each band of FINE.

    electrons/s = sum over bands of radiance in W/(sr m2 nm) * this. One constant for everything:
    the irradiance behind a lens, E = pi L / (4 N^2), times a pixel's area, times the electrons per
    joule at the green peak, times the sensitivity relative to that.
    """
    planck_times_light = 1.98644586e-25  # J m
    electrons_per_joule = camera.peak_efficiency * 530e-9 / planck_times_light
    pixel_area = (camera.pixel_pitch_um * 1e-6) ** 2
    constant = np.pi / (4 * camera.f_number**2) * pixel_area * electrons_per_joule
    step = np.full(len(FINE), FINE[1] - FINE[0])
    step[[0, -1]] /= 2  # trapezia
    return constant * (sensitivities(FINE) * transmittance(filter_name)[:, None]) * step[:, None]


def sensitivities(wavelengths) -> NDArray[np.float64]:
    """The camera's red, green and blue (n, 3) at wavelengths in nm, relative."""
    curves = colour_science().MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    values = [np.interp(wavelengths, curves.wavelengths, c) for c in curves.values.T]
    return np.stack(values, axis=1)


def responses_to_rendered(camera: Camera, filter_name: str) -> NDArray[np.float64]:
    """The same (36, 3) for light known at WAVELENGTHS only, taken as linear in between."""
    between = np.stack([np.interp(FINE, WAVELENGTHS, unit) for unit in np.eye(len(WAVELENGTHS))])
    return between @ responses(camera, filter_name)


def pixel_weights(count: int, subpixels: int, margin: int, shift: float, blur: float):
    """What each pixel of a row gathers from a finer row, as a sparse matrix.

    Its shape is (count, (count + 2 margin) * subpixels). The finer row starts `margin` pixels
    before the first pixel. A pixel gathers a box of its own width, blurred by a Gaussian of
    standard deviation `blur` px, displaced by -shift px: exact for light that is constant over
    each subpixel. Rows sum to 1.
    """
    from scipy.sparse import csr_array
    from scipy.special import ndtr

    def cumulative(x):  # integral from -inf to x of box(-1/2, 1/2) * gaussian
        def ramp(t):  # integral of the normal distribution
            return t * ndtr(t / blur) + blur * np.exp(-0.5 * (t / blur) ** 2) / np.sqrt(2 * np.pi)

        return ramp(x + 0.5) - ramp(x - 0.5)

    reach = int(np.ceil((0.5 + 5 * blur + abs(shift) + 1) * subpixels))
    centre = np.arange(count) + 0.5 - shift + margin  # px from the finer row's start
    first = np.round(centre * subpixels).astype(int) - reach
    column = first[:, None] + np.arange(2 * reach)
    edge = np.concatenate([column, column[:, -1:] + 1], axis=1) / subpixels
    weight = np.diff(cumulative(edge - centre[:, None]), axis=1)
    assert column.min() >= 0, "the margin is too narrow"
    assert column.max() < (count + 2 * margin) * subpixels, "the margin is too narrow"
    row = np.repeat(np.arange(count), column.shape[1])
    shape = (count, (count + 2 * margin) * subpixels)
    return csr_array((weight.ravel(), (row, column.ravel())), shape=shape)


def through_lens(image, camera: Camera, subpixels: int, margin: int, shift):
    """An image of radiance at subpixels, integrated over the camera's pixels.

    image    ((height + 2 margin) * subpixels, (width + 2 margin) * subpixels, C)
    shift    (x, y) px; see FILTER_SHIFTS
    returns  (height, width, C)
    """
    down = pixel_weights(camera.height, subpixels, margin, shift[1], camera.blur_px)
    across = pixel_weights(camera.width, subpixels, margin, shift[0], camera.blur_px)
    rows = (down @ image.reshape(image.shape[0], -1)).reshape(camera.height, *image.shape[1:])
    return np.stack([(across @ rows[..., c].T).T for c in range(image.shape[2])], axis=-1)


def mosaic(colours):
    """The RGGB samples (H, W) of an image (H, W, 3)."""
    samples = np.empty(colours.shape[:2], colours.dtype)
    for row in (0, 1):
        for column in (0, 1):
            samples[row::2, column::2] = colours[row::2, column::2, row + column]
    return samples


def expose(electrons_per_second, time_s: float, camera: Camera, rng) -> NDArray[np.uint16]:
    """Raw samples (H, W) of one exposure of a mosaic (H, W) of photo-electrons per second."""
    shape = electrons_per_second.shape
    pattern = np.random.default_rng(camera.pattern_seed)
    gain = 1.0 + camera.prnu * pattern.standard_normal(shape)
    dark = np.zeros(shape)  # electrons/s, of hot pixels: about 30 a megapixel
    hot = pattern.random(shape) < 3e-5
    dark[hot] = 10.0 ** pattern.uniform(2.0, 4.5, hot.sum())
    electrons = rng.poisson((electrons_per_second * gain + dark) * time_s).astype(np.float64)
    electrons += camera.read_noise * rng.standard_normal(shape)
    raw = np.round(camera.black_level + electrons / camera.electrons_per_step)
    return np.clip(raw, 0, camera.saturation_level).astype(np.uint16)
