"""From the camera's bands to light in primaries: drift, transform, normalise, join, illuminants."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration import bands as camera_bands
from calibration import chromaticity, estimate, metals, spectra, training
from pipeline import io
from pipeline.capture import Capture
from pipeline.settings import Settings
from pipeline.steps.files import ORIENTATION, channels, header_of, light_header, read_sphere
from pipeline.steps.step import Learnt
from stages import cube
from stages.assess import assess, shared_noise
from stages.drift import drift, worth_telling
from stages.illuminants import Illuminant, illuminants, impossible
from stages.join import join
from stages.normalise import normalise, reflectance_at
from stages.transform import transform
from stages.unwrap import BAYER_NOISE_AREA_PX, BAYER_NOISE_CORRELATION


def drift_given(capture: Capture, settings: Settings, index: int):
    c, filters = capture.calibration, [f.name for f in capture.filters]
    sensitivities = None
    if c.camera is not None and c.filters is not None:
        camera = spectra.read_spectra(c.camera, "power")
        glass = spectra.read_spectra(c.filters, "fraction")
        sensitivities = camera_bands.sensitivities(camera, glass, filters)[1].tolist()
    t = capture.transform
    signals = None if t is None or t.signals is None else t.signals.tolist()
    return {"filters": filters, "sensitivities": sensitivities, "signals": signals}


def run_drift(read, write, *, filters, sensitivities, signals) -> Learnt:
    """sensitivities, or signals of a chart: what light looks like to the bands, None if unknown."""
    bands, names = io.read_measured(read[0], cube=True)
    noise_area_px = [BAYER_NOISE_AREA_PX["RGB".index(name[-1])] for name in names]
    common = shared_noise(read_sphere(read[1]), bands.values.shape[1], noise_area_px)
    known = None
    if sensitivities is not None:
        lights, surfaces = training.checked(None, None)
        known = training.lit(lights.values.T, training.with_white(surfaces)[0]) @ sensitivities
    elif signals is not None:
        known = np.array(signals)
    changes = drift(bands, common=common, known=known)
    later = filters[1:]
    header = header_of("drift") | {
        "orientation": ORIENTATION,
        "unit": f"log_ratio: ln of the light in this filter's photographs over {filters[0]}'s;"
        " significance: that in standard deviations",
    }
    maps = [m for c in changes for m in (c.log_ratio, c.log_ratio / c.sigma)]
    channels = [f"{name}.{what}" for name in later for what in ("log_ratio", "significance")]
    faces = np.stack(maps, axis=-1)
    io.write_exr(write[0], faces.reshape(-1, *faces.shape[-2:]), channels, header)
    return {
        "against": filters[0],
        "absolute": any(change.overall is not None for change in changes),
        "filters": {
            name: {
                "share_of_light": change.share,
                "largest_ratio": change.largest,
                "direction": change.direction,
                "overall_ratio": change.overall,
                "overall_log_sigma": change.overall_log_sigma,
            }
            for name, change in zip(later, changes, strict=True)
        },
        "notes": worth_telling(changes, filters),
    }


# --------------------------------------------------------------------------------------- colour


def transform_given(capture: Capture, settings: Settings, index: int):
    t = capture.transform
    assert t is not None
    return {"matrix": t.matrix.tolist(), "header": light_header(capture)}


def run_transform(read, write, *, matrix, header) -> Learnt:
    bands, _ = io.read_measured(read[0], cube=True)
    # Each filter's photographs have noise of their own.
    correlation = np.kron(np.eye(bands.values.shape[-1] // 3), BAYER_NOISE_CORRELATION)
    light = transform(bands, matrix, correlation)
    io.write_measured(write[0], light, channels(len(matrix)), header | {"step": "transform"})
    return {}


def normalise_given(capture: Capture, settings: Settings, index: int):
    angles = np.linspace(0.0, np.pi / 2, 361)
    sphere = capture.sphere
    assert capture.primaries is not None
    assert capture.transform is not None
    table = metals.in_primaries(
        capture.primaries, angles, material=sphere.material, known=sphere.reflectance
    )
    return {
        "angles_rad": angles.tolist(),
        "reflectance": table.tolist(),
        "matrix": capture.transform.matrix.tolist(),
        "xyz_from_primaries": capture.primaries.xyz_from_primaries.tolist(),
        "header": light_header(capture),
    }


def run_normalise(
    read, write, *, angles_rad, reflectance, matrix, xyz_from_primaries, header
) -> Learnt:
    reflected, names = io.read_measured(read[0], cube=True)
    sphere = read_sphere(read[1])
    n = reflected.values.shape[1]
    incidence = sphere.incidence_angle(cube.directions(n))
    of_texel = reflectance_at(incidence, angles_rad, reflectance)
    light = normalise(reflected, of_texel)
    io.write_measured(write[0], light, names, header | {"step": "normalise"})
    # The file keeps the primaries' variances alone; here the bands' are known, and with them all.
    bands, band_names = io.read_measured(read[2], cube=True)
    noise_area_px = [BAYER_NOISE_AREA_PX["RGB".index(name[-1])] for name in band_names]
    common = shared_noise(sphere, n, noise_area_px)
    noise = assess(bands, matrix, of_texel, xyz_from_primaries, common)
    return {
        "near_normal_reflectance": reflectance[0],
        "white_delta_e_noise": dataclasses.asdict(noise),
    }


def join_given(capture: Capture, settings: Settings, index: int):
    return {"names": [view.name for view in capture.views], "header": light_header(capture)}


def run_join(read, write, *, names, header) -> Learnt:
    lights, spheres = read[: len(names)], read[len(names) :]
    views = [io.read_measured(path, cube=True) for path in lights]
    joined = join([light for light, _ in views], [read_sphere(path) for path in spheres])
    io.write_measured(write[0], joined.light, views[0][1], header | {"step": "join"})
    return {
        "share_of_directions": dict(zip(names, joined.shares, strict=True)),
        "removed": dict(zip(names, joined.removed, strict=True)),
        "seen": float(joined.light.valid.mean()),
    }


def illuminants_given(capture: Capture, settings: Settings, index: int):
    return {"primaries": capture.primaries}


def run_illuminants(read, write, *, primaries) -> Learnt:
    light, _ = io.read_measured(read[0], cube=True)
    found = illuminants(light, primaries.xyz_from_primaries[1])
    names = *(f"light {i}" for i in range(1, len(found))), "everything else"
    spectrum_of = estimate.spectra_from_primaries(primaries)
    estimated = np.stack([spectrum_of @ f.light for f in found], axis=1)
    spectra.write_spectra(write[0], spectra.Spectra(spectra.WAVELENGTHS, names, estimated))
    return {
        "lights": [
            {"name": name, **dataclasses.asdict(f), **_colour_of(primaries.xyz_from_primaries, f)}
            for name, f in zip(names, found, strict=True)
        ],
        "share_of_impossible_colour": impossible(light, primaries.xyz_from_primaries),
    }


def _colour_of(xyz_from_primaries, light: Illuminant) -> Learnt:
    xyz = xyz_from_primaries @ light.light
    white = chromaticity.temperature(xyz)
    return {
        "xyz": xyz,
        "xy": chromaticity.chromaticity(xyz),
        "temperature_k": None if white is None else white.kelvin,
        "duv": None if white is None else white.duv,
    }
