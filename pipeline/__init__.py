"""When and where: everything around the stages; and, for notebooks, the calls of `pipeline.api`."""

from importlib import import_module

_API = ("EnvironmentMap", "envmap", "fit", "load", "render")


def __getattr__(name: str):
    # Only when asked for: the command line is to answer at once, and a step's code is not to
    # depend on all that a notebook may call.
    if name in _API:
        return getattr(import_module("pipeline.api"), name)
    raise AttributeError(f"module 'pipeline' has no attribute {name!r}")
