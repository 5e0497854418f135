"""The compiled step on disk: found by the next process, and not missed where no file lasts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba import types
from numba.core.compiler import Flags

from vpptwin.engine import store
from vpptwin.engine.compile import c_function, can_keep, compilable, hashed_once
from vpptwin.engine.store import open_entry, seal_entry
from vpptwin.twin.stepping.pipeline import fingerprint

ROOT = Path(__file__).resolve().parents[2]
MODEL = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="slide" type="slide" damping="0.5"/>
<geom size="0.1"/></body></worldbody></mujoco>"""
TWIN = "model: slide.xml\nsignals: {joints: {slide: /joint_states}}\n"
PROGRAM = """
import sys
import tempfile
def refuse(*args, **kwargs):
    raise PermissionError(13, "read-only")
if "read-only" in sys.argv:
    tempfile.TemporaryFile = refuse  # by which numba asks whether it may write into a folder
from vpptwin.twin import Twin, load_twin
import numpy as np
twin = Twin(load_twin(sys.argv[1]), 1, active=["slide.coulomb"])
twin.set_parameter("slide.coulomb", "force", 0.3)
state = twin.replay_commands(twin.initial_state(qvel=np.array([0.5])), np.zeros((1, 20, 0)))[0]
twin.warm_up(state.actuators, np.zeros((1, 3, 0)))
from vpptwin.twin.stepping.kernel import _KERNELS
print(sum(compiled.cache_hits for _, compiled in _KERNELS.values()), float(state.qpos[0, 0]).hex())
"""

LAYERS = """
import sys
import numpy as np
from vpptwin.actuators.layer import constants_dtype, layer_dtype, nominal_constants
from vpptwin.twin.stepping.kernel import warm_up
for nu in map(int, sys.argv[1:]):
    layer, constants = np.zeros(1, layer_dtype(nu, 4)), np.zeros(1, constants_dtype(nu, nu))
    for name, value in nominal_constants(0.05, constants).items():
        constants[name] = value
    print(warm_up(layer, constants, np.ones((1, 5, nu)), np.zeros(1, int), 0.01)["horn"].tolist())
"""


@pytest.fixture(scope="module")
def twin_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A twin of one slide, whose step compiles quickly."""
    folder = tmp_path_factory.mktemp("slide")
    (folder / "slide.xml").write_text(MODEL)
    (folder / "twin.yaml").write_text(TWIN)
    return folder / "twin.yaml"


SAID: list[str] = []
"""What each process said on standard error, which is no terminal."""


def run_program(program: str, cache: Path, *arguments: str) -> list[str]:
    """Run a program in a process of its own; the lines that it prints."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    SAID.append(done.stderr)
    return done.stdout.splitlines()


def run(twin: Path, cache: Path, *flags: str) -> tuple[int, str]:
    """Simulate in a process of its own; how often numba found its code on disk, and where the slide got to."""
    hits, position = run_program(PROGRAM, cache, str(twin), *flags)[-1].split()
    return int(hits), position


def list_files(folder: Path) -> dict[str, tuple[int, int]]:
    """Every file with its size and when it was written [ns]."""
    return {str(f): (f.stat().st_size, f.stat().st_mtime_ns) for f in folder.rglob("*") if f.is_file()}


@pytest.fixture(scope="module")
def first(twin_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The cache that a first process has filled, and where its slide got to."""
    cache = tmp_path_factory.mktemp("cache")
    hits, position = run(twin_file, cache)
    assert hits == 0
    assert SAID[-1] == "vpptwin: compiling the step of this rig, once, 10 to 30 s\n"
    return cache, position


def test_second_process_compiles_nothing(twin_file: Path, first: tuple[Path, str]) -> None:
    """The next process finds the compiled step on disk, writes no file and gets to the same place."""
    cache, position = first
    before = list_files(cache / "vpptwin")
    assert any(name.endswith(".nbc") for name in before)
    assert run(twin_file, cache) == (2, position)  # the step, and what warms actuators up
    assert SAID[-1] == ""
    assert list_files(cache / "vpptwin") == before


def test_steps_that_two_processes_left_are_not_confused(tmp_path: Path) -> None:
    """Functions of one name, each the first that its process compiled: a third process loads both and runs either."""
    apart = [run_program(LAYERS, tmp_path, count)[0] for count in ("1", "3")]
    assert run_program(LAYERS, tmp_path, "1", "3") == apart
    assert run_program(LAYERS, tmp_path, "3", "1") == apart[::-1]


def test_a_rig_of_the_same_sizes_shares_the_step(twin_file: Path, first: tuple[Path, str]) -> None:
    """A model that differs in numbers alone runs the same compiled step, to another place."""
    cache, position = first
    other = twin_file.parent / "other.yaml"
    (twin_file.parent / "other.xml").write_text(MODEL.replace('name="slide"', 'name="slide" armature="0.1"'))
    other.write_text(TWIN.replace("slide.xml", "other.xml"))
    hits, elsewhere = run(other, cache)
    assert (hits, elsewhere != position) == (2, True)
    assert len(list((cache / "vpptwin" / "kernels").iterdir())) == 2


def test_an_effects_file_may_move() -> None:
    """The same text in another place is another step: numba keeps the name of its module, which holds the place."""
    kept = set()
    for name in ("vpptwin_effects_here", "vpptwin_effects_there"):
        module = ModuleType(name)
        exec(compile("def push(force):\n    return force\n", "own.py", "exec"), vars(module))
        kept.add(fingerprint("step", functions=[module.push]))
    assert len(kept) == 2


@pytest.mark.slow
def test_without_a_cache_it_compiles_in_memory(twin_file: Path, first: tuple[Path, str]) -> None:
    """Where no folder can be written, a twin compiles its step in memory and does the same; the cache stays as is."""
    cache, position = first
    before = list_files(cache)
    assert run(twin_file, cache, "read-only") == (0, position)
    assert list_files(cache) == before


def test_text_needs_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no folder can be made for the text of a step, there is none; a text that was cut off is written anew."""
    monkeypatch.setattr("vpptwin.engine.store.user_cache_path", lambda name: tmp_path / name)
    file = open_entry("key", "whole text")
    assert file is not None
    file.write_text("whole")
    assert open_entry("key", "whole text") == file
    assert file.read_text() == "whole text"
    monkeypatch.setattr("vpptwin.engine.store.user_cache_path", lambda name: file / name)
    assert open_entry("key", "whole text") is None


def fill(cache: Path, monkeypatch: pytest.MonkeyPatch, name: str = "key", size: int = 9) -> Path:
    """A sealed entry in a cache, with something compiled in it."""
    monkeypatch.setattr("vpptwin.engine.store.user_cache_path", lambda name: cache / name)
    file = open_entry(name, "text")
    assert file is not None
    (file.parent / "__pycache__").mkdir()
    (file.parent / "__pycache__" / "step.control.nbc").write_bytes(bytes(size))
    seal_entry(file)
    return file


def list_compiled(file: Path) -> list[str]:
    """What is compiled beside a file."""
    return sorted(path.name for path in file.parent.rglob("*.nb?"))


def test_the_cache_is_the_users_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders of mode 700; what lay in a folder that others could write into is not loaded."""
    file = fill(tmp_path, monkeypatch)
    for folder in (file.parent, file.parent.parent):
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list_compiled(file) == ["step.control.nbc"]
    assert open_entry("key", "text") == file
    assert list_compiled(file) == ["step.control.nbc"]
    for open_one in (file.parent, file.parent.parent):
        open_one.chmod(0o777)
        assert open_entry("key", "text") == file
        assert list_compiled(file) == []
        assert open_one.stat().st_mode & 0o777 == 0o700
        (file.parent / "__pycache__").mkdir()
        (file.parent / "__pycache__" / "step.control.nbc").write_bytes(bytes(9))
        seal_entry(file)


def test_a_cache_of_someone_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is loaded from another owner's folder, or through a link; a missing home is no place either."""
    fill(tmp_path, monkeypatch)
    monkeypatch.setattr("os.getuid", lambda: 12345)
    assert open_entry("key", "text") is None
    monkeypatch.undo()
    fill(tmp_path / "real", monkeypatch)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "vpptwin").symlink_to(tmp_path / "real" / "vpptwin")
    monkeypatch.setattr("vpptwin.engine.store.user_cache_path", lambda name: tmp_path / "other" / name)
    assert open_entry("key", "text") is None
    monkeypatch.setattr("vpptwin.engine.store.user_cache_path", lambda name: Path("~") / name)
    assert open_entry("key", "text") is None
    assert not Path("~").exists()


@pytest.mark.parametrize("how", ["changed", "added", "unsealed", "a file", "no text"])
def test_an_entry_that_is_not_what_was_sealed_is_built_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """A flipped byte, a foreign file, a lost seal, or something else in its place: emptied, not loaded."""
    file = fill(tmp_path, monkeypatch)
    compiled = file.parent / "__pycache__" / "step.control.nbc"
    if how == "changed":
        compiled.write_bytes(b"x" + compiled.read_bytes()[1:])
    elif how == "added":
        compiled.with_name("step.other.nbi").write_bytes(b"x")
    elif how == "unsealed":
        (file.parent / store.SEAL).unlink()
    elif how == "a file":
        shutil.rmtree(file.parent)
        file.parent.write_text("x")
    else:
        file.write_bytes(b"\xff\xfe")
        assert open_entry("key", "text") is None
        file.unlink()
        return
    assert open_entry("key", "text") == file
    assert list_compiled(file) == []
    assert file.read_text() == "text"


def test_the_oldest_entries_make_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many models come by, so many are kept."""
    monkeypatch.setattr(store, "MAX_ENTRIES", 5)
    for number in range(9):
        entry = fill(tmp_path, monkeypatch, f"key{number}").parent
        os.utime(entry, (number, number))
    kept = sorted(path.name for path in (tmp_path / "vpptwin" / "kernels").iterdir())
    assert kept == [f"key{number}" for number in range(4, 9)]


def compile_twice(folder: Path) -> tuple[int, float]:
    """Compile a small function from a file; how often it was found on disk, and what it makes of 2."""
    file = folder / "twice.py"
    file.write_text("def twice(x):\n    return 2.0 * x\n")
    namespace: dict = {"__name__": __name__}
    exec(compile(file.read_text(), str(file), "exec"), namespace)
    compiled = c_function(types.float64(types.float64))(namespace["twice"])
    return compiled.cache_hits, compiled.ctypes(2.0)


@pytest.mark.parametrize("pattern", ["*.nbi", "*.nbc"])
def test_a_damaged_file_is_compiled_over(tmp_path: Path, pattern: str) -> None:
    """A cache of which a file was cut off, as by a full disk, is written anew."""
    assert compile_twice(tmp_path) == (0, 4.0)
    assert compile_twice(tmp_path) == (1, 4.0)
    (file,) = tmp_path.rglob(pattern)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert compile_twice(tmp_path) == (0, 4.0)
    assert compile_twice(tmp_path) == (1, 4.0)


def test_compiles_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function is compiled in memory where numba finds no folder for it, and nothing is asked to be kept there."""

    def refuse(*args: object, **kwargs: object) -> None:
        raise PermissionError(13, "read-only")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    assert compile_twice(tmp_path) == (0, 4.0)
    assert not list(tmp_path.rglob("*.nb?"))
    assert can_keep.__wrapped__() is False


CALLS = """\
@compilable(keep=True)
def twice(x):
    return 2.0 * x
def more(x):
    return 1.0 + twice(x)
"""


def compile_both(folder: Path) -> float:
    """Compile a function that calls one that is kept for others, too; what it makes of 2."""
    file = folder / "twice.py"
    file.write_text(CALLS)
    namespace: dict = {"__name__": __name__, "compilable": compilable}
    exec(compile(file.read_text(), str(file), "exec"), namespace)
    return c_function(types.float64(types.float64))(namespace["more"]).ctypes(2.0)


@pytest.mark.parametrize("pattern", ["twice.twice*.nbi", "twice.twice*.nbc"])
def test_a_damaged_file_of_what_is_called_is_compiled_over(tmp_path: Path, pattern: str) -> None:
    """What all rigs share is written anew where it was cut off, whole: what comes then takes it as it is."""
    assert compile_both(tmp_path) == 5.0
    (file,) = tmp_path.rglob(pattern)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    written = []
    for _ in range(2):
        for other in tmp_path.rglob("twice.more*.nb?"):
            other.unlink()
        assert compile_both(tmp_path) == 5.0
        written.append(file.read_bytes())
    assert len(written[0]) > len(whole) // 2
    assert written[1] == written[0]


def test_a_full_disk_keeps_nothing_and_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither what is called nor what calls it is missed."""

    def refuse(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.os.replace", refuse)
    assert compile_both(tmp_path) == 5.0
    assert not list(tmp_path.rglob("*.nb?"))


def test_what_makes_arrays_compiles() -> None:
    """An effect of a user's may make an array, whose users numba then counts."""

    def total(x: float) -> float:
        array = np.zeros(3)
        array[1] = x
        return array.sum()

    assert c_function(types.float64(types.float64), keep=False)(total).ctypes(2.0) == 2.0


def test_options_are_told_apart_as_by_numba() -> None:
    """What is compiled under some options is taken for others nowhere; set to its default, an option is the default."""
    plain, default, inlined, again = Flags(), Flags(), Flags(), Flags()
    default.forceinline = False
    inlined.forceinline = again.forceinline = True
    everything = [plain, default, inlined, again, Flags(inlined)]
    found = [[a == b for a in everything] for b in everything], [hash(a) for a in everything]
    with hashed_once():
        assert ([[a == b for a in everything] for b in everything], [hash(a) for a in everything]) == found
        assert plain != 1
    assert found[0][0] == [True, True, False, False, False]
