"""Formats of files, each known to one module, which knows nothing of captures and their steps.

raw, decoding, tiff          photographs: what LibRaw and their tags say, in processes of their own
tables, spectra              the user's TOML and CSV, read so that all that is wrong is told at once
header, spectral_exr         EXR: what images in primaries say of themselves, images of spectra
dds, ktx2, video             what engines and players read
meshes, scenes               what a preview can show

Images of the common kinds are `pipeline.io`'s.
"""
