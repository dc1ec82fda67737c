from pipeline.api import EnvironmentMap as EnvironmentMap
from pipeline.api import envmap as envmap
from pipeline.api import fit as fit
from pipeline.api import load as load
from pipeline.api import render as render
