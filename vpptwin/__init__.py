"""vpptwin: a simulation twin that finds what your simulation gets wrong.

What is listed here is imported when it is asked for: `import vpptwin` costs nothing.
"""

from importlib import import_module

TYPE_CHECKING = False  # `typing` itself takes as long as all else before Ctrl-C is heeded
if TYPE_CHECKING:
    from vpptwin.diagnosis.judgement.verdict import Verdict as Verdict
    from vpptwin.drift.history import History as History
    from vpptwin.drift.history import history as history
    from vpptwin.logs import Flight as Flight
    from vpptwin.report.compare import Comparison as Comparison
    from vpptwin.report.compare import compare as compare
    from vpptwin.report.result import Result as Result
    from vpptwin.report.result import diagnose as diagnose
    from vpptwin.report.sources import read_log as read_log
    from vpptwin.system.errors import InputError as InputError
    from vpptwin.train.env.environments import make_task_env as make_env
    from vpptwin.twin import Twin as Twin
    from vpptwin.twin import TwinSpec as TwinSpec
    from vpptwin.twin import load_twin as load_twin

__version__ = "0.1.0"
__all__ = [
    "Comparison", "Flight", "History", "InputError", "Result", "Twin", "TwinSpec", "Verdict", "__version__", "compare",
    "diagnose", "history", "load_twin", "make_env", "read_log",
]  # fmt: skip

_PLACES = {
    "Comparison": "vpptwin.report.compare:Comparison",
    "Flight": "vpptwin.logs:Flight",
    "History": "vpptwin.drift.history:History",
    "InputError": "vpptwin.system.errors:InputError",
    "Result": "vpptwin.report.result:Result",
    "Twin": "vpptwin.twin:Twin",
    "TwinSpec": "vpptwin.twin:TwinSpec",
    "Verdict": "vpptwin.diagnosis.judgement.verdict:Verdict",
    "compare": "vpptwin.report.compare:compare",
    "diagnose": "vpptwin.report.result:diagnose",
    "history": "vpptwin.drift.history:history",
    "load_twin": "vpptwin.twin:load_twin",
    "make_env": "vpptwin.train.env.environments:make_task_env",
    "read_log": "vpptwin.report.sources:read_log",
}


def __getattr__(name: str) -> object:
    """Import what is asked for (PEP 562).

    Raises:
        AttributeError: if there is no such name, or what it needs is not installed; `hasattr` asks so.
    """
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, there = _PLACES[name].partition(":")
    try:
        found: object = getattr(import_module(module), there)
    except ImportError as error:
        from vpptwin.system.errors import MissingError, explain_missing

        problem = explain_missing(error, f"vpptwin.{name}") if isinstance(error, ModuleNotFoundError) else None
        if problem is None:
            raise AttributeError(f"vpptwin.{name} cannot be imported: {error}") from error
        raise MissingError(problem.found, problem.expected, problem.action) from error
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
