"""What others would do with the same logs: each method names one effect, or none.

`Method` takes the flights of a session and returns the id of the effect that it blames, "" for none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from proving.runner.baselines.ranking import name_by_ranking
from proving.runner.baselines.sparse import name_by_regression
from proving.runner.baselines.sysid import name_by_sysid
from vpptwin.logs.flight import Flight

Method = Callable[[Sequence[Flight]], str]
BASELINES: dict[str, Method] = {
    "each effect fitted alone, lowest RMSE": name_by_ranking,
    "pysindy STLSQ on the missing wrench": name_by_regression,
    "mujoco.sysid, largest standardised change": name_by_sysid,
}
