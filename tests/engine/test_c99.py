"""Python traced into C99: what gcc makes of it computes what Python does."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from vpptwin.engine.trace.c99 import CWriter, make_array
from vpptwin.engine.trace.terms import Term, Unwritable

FRAME = """\
static float smaller(float x, float y) {{ return y < x ? y : x; }}
static float larger(float x, float y) {{ return y > x ? y : x; }}
static float size(float x) {{ return larger(x, -x); }}
float run(float *m, float x)
{{
{body}
}}
int used(void) {{ return (int)(smaller(1.0f, 2.0f) + size(1.0f)); }}
"""


def swap(m: np.ndarray, x: float) -> float:
    """What was read before a write stays what it was."""
    first = m[0]
    m[0] = m[1]
    m[1] = first
    return first - (m[0] - (x - 1.0))


def limit(m: np.ndarray, x: float) -> float:
    """Branches that return, a slice that is written, conditions, whole numbers."""
    part = m[1:3]
    for i in range(2):
        part[i] += -x * (i + 1)
    m[0] = 3 if x > 1.0 and not m[1] > 0.0 else 4
    if m[0] == 3 or x < -2.0:
        return min(max(x / 3.0, -m[2]), 0.5)
    m[3] -= 2.0 * x
    return -np.abs(x) if m[0] > 3.5 else x


@pytest.mark.parametrize("function", [swap, limit])
def test_compiled_text_computes_what_python_does(function: object, tmp_path: Path) -> None:
    """Result and memory are those of Python in float32, to the last bit."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs gcc: apt install gcc")
    assert callable(function)
    writer = CWriter()
    result = writer.call(function, [make_array([f"m[{i}]" for i in range(4)]), Term("x")])
    writer.lines.append(f"return {writer.write_out(result)}")
    (tmp_path / "run.c").write_text(FRAME.format(body=writer.finish()))
    options = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "run.c", "-o", "run.so")
    subprocess.run([compiler, *options], cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "run.so"))
    library.run.restype = ctypes.c_float
    for x in np.float32([-3.1, -0.7, 0.0, 0.3, 1.7]):
        wanted = np.float32([0.4, 0.9, 0.2, -0.6])
        found = wanted.copy()
        pointer = found.ctypes.data_as(ctypes.POINTER(ctypes.c_float))
        assert library.run(pointer, ctypes.c_float(x)) == np.float32(function(wanted, x))
        np.testing.assert_array_equal(found, wanted)


def test_what_only_a_library_has_is_refused() -> None:
    """The sine of what is known is a number; of what is not, a line that says so."""
    writer = CWriter()
    writer.lines.append(f"return {writer.write_out(writer.call(mix_sines, [Term('x')]))}")
    with pytest.raises(Unwritable, match="needs sin"):
        writer.finish()


def mix_sines(x: float) -> float:
    """One sine that is known, and one that is not."""
    return np.sin(0.5) * np.sin(x)
