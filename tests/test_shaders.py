"""Shaders are found, put together, compiled, and blamed by the name a person knows them under."""

import itertools

import pytest

import shaders

MESA = """GLSL Compiler failed

fragment_shader
===============
0:4(12): error: `missing' undeclared
0:5(1): warning: something else
"""
NVIDIA = """GLSL Compiler failed

fragment_shader
===============
0(4) : error C1503: undefined variable "missing"
"""


@pytest.fixture(scope="module")
def context():
    moderngl = pytest.importorskip("moderngl")
    context = moderngl.create_context(
        standalone=True, backend="egl", libgl="libGL.so.1", libegl="libEGL.so.1"
    )
    yield context
    context.release()


@pytest.fixture
def broken(tmp_path):
    """A shader whose included file has its fault on line 2."""
    (tmp_path / "include").mkdir()
    (tmp_path / "include" / "fault.glsl").write_text("// fine\nfloat f() { return missing; }\n")
    (tmp_path / "a.vert").write_text("void main() { gl_Position = vec4(0.0); }\n")
    (tmp_path / "a.frag").write_text(
        'out vec4 colour;\n#include "fault.glsl"\nvoid main() { colour = vec4(f()); }\n'
    )
    return tmp_path


SURFACES = ("ward.frag", "ward1992.frag", "ggx.frag")
PAIRS = [
    ("surface.vert", "surface.frag", ("SHADED",)),
    *[("screen.vert", name, ("SHADED", "ANGULAR", "TEXTURED")) for name in SURFACES],
    ("screen.vert", "environment.frag", ()),
    ("screen.vert", "latlong.frag", ()),
    ("screen.vert", "reduce.frag", ()),
    ("screen.vert", "display.frag", ()),
    ("shadow.vert", "shadow.frag", ()),
]


@pytest.mark.parametrize("version", [shaders.VERSION, shaders.ES_VERSION])
@pytest.mark.parametrize(("vertex", "fragment", "switches"), PAIRS)
def test_every_pair_compiles_for_desktops_and_for_browsers(
    context, vertex, fragment, switches, version
):
    for triples in (1, 2, 3):
        for values in itertools.product((0, 1), repeat=len(switches)):
            defines = {"TRIPLES": triples, **dict(zip(switches, values, strict=True))}
            shaders.program(context, vertex, fragment, version=version, defines=defines).release()


def test_no_shader_is_left_out_of_the_test_above():
    assert set(shaders.names()) == {name for pair in PAIRS for name in pair[:2]}


def test_the_compiler_blames_the_file_and_line_that_are_wrong(context, broken):
    with pytest.raises(shaders.ShaderError, match=r"include/fault\.glsl:2: .*missing"):
        shaders.program(context, "a.vert", "a.frag", folder=broken)


@pytest.mark.parametrize("log", [MESA, NVIDIA])
def test_the_drivers_own_lines_become_files_and_lines(broken, log):
    # expanded: 1 #version, 2 a.frag:1, 3 fault.glsl:1, 4 fault.glsl:2, 5 a.frag:3
    said = shaders.where_written(log, {"fragment_shader": shaders.load("a.frag", folder=broken)})
    assert "include/fault.glsl:2: error" in said
    if log is MESA:
        assert "a.frag:3: warning: something else" in said


def test_includes_nest_and_each_file_comes_once(tmp_path):
    (tmp_path / "include").mkdir()
    (tmp_path / "include" / "one.glsl").write_text("one\n")
    (tmp_path / "include" / "two.glsl").write_text('#include "one.glsl"\ntwo\n')
    (tmp_path / "a.frag").write_text('#include "two.glsl"\n#include "one.glsl"\nlast\n')
    source = shaders.load("a.frag", folder=tmp_path, defines={"TRIPLES": 2})
    assert source.text == f"{shaders.VERSION}\n#define TRIPLES 2\none\ntwo\nlast\n"
    assert source.lines[2:] == (("include/one.glsl", 1), ("include/two.glsl", 2), ("a.frag", 3))


def test_a_missing_include_is_named_where_it_is_asked_for(tmp_path):
    (tmp_path / "a.frag").write_text('// first\n#include "gone.glsl"\n')
    with pytest.raises(shaders.ShaderError, match=r"^a\.frag:2: .*include/gone\.glsl"):
        shaders.load("a.frag", folder=tmp_path)
