"""M_S and M_R fitted together."""

import numpy as np
from chart_session import bands, glasses

from calibration import sets
from calibration.difference import delta_e_2000
from calibration.joint import fit_together
from calibration.optimise import adapted_lab, true_lab
from calibration.primaries import load
from calibration.training import ROOM_SURFACES, computed


def test_the_two_matrices_beat_two_pseudo_inverses():
    """On the ColorChecker, never trained on, photographed in D50 and seen in the paper's lights."""
    primaries = load("darling2011")
    lights, chart = sets.lights("darling2011"), sets.surfaces("colorchecker24").values.T
    camera, (_, curves) = (sets.camera("nikon5100"), glasses()), bands()
    m_s, m_r = fit_together(
        computed(*camera, lights=lights),
        computed(*camera, lights=lights.only(["D50"]), quantity="reflectance"),
        primaries,
        noise_level=0.002,
    )
    assert (m_s.quantity, m_r.quantity) == ("light", "reflectance")
    lamps, d50 = lights.values.T, lights["D50"]
    train = np.vstack([sets.surfaces(ROOM_SURFACES).values.T, np.ones(36)])

    def seen(reflectances):
        return (reflectances * d50) @ curves / (d50 @ curves)

    def plain(signals, spectra):
        return np.linalg.lstsq(signals, primaries.project(spectra))[0].T

    pairs = {
        "joint": (m_s.matrix, m_r.matrix),
        "pinv": (plain(lamps @ curves, lamps), plain(seen(train), train)),
    }
    errors = {}
    for name, (light, surface) in pairs.items():
        product = (lamps @ curves @ light.T)[:, None] * (seen(chart) @ surface.T)
        found = adapted_lab(product @ primaries.xyz_from_primaries.T, lights)
        true = true_lab(lights, sets.surfaces("colorchecker24"))
        errors[name] = delta_e_2000(true, found).mean()
    assert errors["joint"] < 0.75 * errors["pinv"]
