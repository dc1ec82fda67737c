"""Colour: spectra, rendering primaries, fits, the sphere's metal; importable without the rest."""
