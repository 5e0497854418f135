"""The benchmark of hidden effects counts right: sequences, rates worked by hand, results that are taken up again."""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import hidden_effects
import numpy as np
import pytest

from proving.drone import (
    ALIEN,
    COMPANIONS,
    CORE,
    EFFECTS,
    EXTENDED,
    FORMS,
    LOOK_ALIKES,
    Wind,
    measure_strength,
    true_size,
)
from proving.runner import campaign, case, commits, costs, draw, pictures, rates, scores

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def strength(effect: str) -> str:
    """Name of an effect's first parameter."""
    return next(iter((EFFECTS | COMPANIONS)[effect]))


def fitted(value: float, std: float) -> dict[str, float]:
    """A made-up estimate."""
    return {"value": value, "std": std, "nominal": 0.0}


def finding(*causes: Any, left: bool = False, chi2: tuple[float, float] = (9.0, 1.0)) -> Any:  # noqa: ANN401
    """A made-up verdict: causes as (effect, confidence, rivals, value, std)."""
    named = [
        case.Named(effect, confidence, 0.9, {strength(effect): fitted(value, std)}, dict(rivals))
        for effect, confidence, rivals, value, std in causes
    ]
    return case.Finding(named, left, "", chi2, [], "", 30.0)


def cause(effect: str, confidence: float = 0.99, rivals: Any = (), value: float = 1.0, std: float = 0.1) -> tuple:  # noqa: ANN401
    """A made-up cause."""
    return effect, confidence, rivals, value, std


def session(number: int, kind: str, hidden: dict, found: Any, oracle: Any = None, rig: int = 3, **plan: Any) -> Any:  # noqa: ANN401
    """A made-up session."""
    return case.Case(draw.Plan(number, kind, hidden, rig, **plan), found, oracle)


def table(cases: list) -> dict[str, str]:
    """Measure → result."""
    return {row.name: row.text for row in rates.summarise(cases)}


def test_kinds_and_order_of_sessions() -> None:
    """Eight hide one effect, two one of another form, three two, one three, three an alien, three none, at any seed."""
    for seed in range(5):
        kinds = Counter(draw.draw_plan(seed, n).kind for n in range(20, 40))
        assert kinds == {"single": 8, "form": 2, "two": 3, "three": 1, "alien": 3, "none": 3}
    # Two look-alikes suffice for sessions of one effect.
    few = ("rail_x.coulomb", "rail_x.stiction")
    plans = draw.draw_plans(7, few, kinds=("single",))
    assert {next(iter(plan.hidden)) for plan in islice(plans, 4)} == set(few)
    # Session 12 is the same alone, in a long run and in a run of its kind only; another seed has another.
    alone = draw.draw_plan(5, 12)
    among: Iterator = draw.draw_plans(5)
    assert [next(among) for _ in range(13)][12] == alone
    assert next(p for p in draw.draw_plans(5, kinds=(alone.kind,)) if p.number == 12) == alone
    assert draw.draw_plan(6, 12) != alone
    assert len({draw.draw_plan(5, n).wind for n in range(6)}) == 6


@pytest.mark.parametrize(
    ("kind", "pool"), [("single", (*CORE, *EXTENDED, *COMPANIONS)), ("alien", ALIEN), ("form", FORMS)]
)
def test_single_effects_take_turns(kind: str, pool: Iterable[str]) -> None:
    """The first 44 sessions with one effect hide each of the catalogue once; aliens and other forms take turns too."""
    plans = draw.draw_plans(7, kinds=(kind,))
    effects = [list(next(plans).hidden)[-1] for _ in pool]
    assert sorted(effects) == sorted(pool)


def test_small_deviations_leave_no_gap_and_are_no_look_alikes() -> None:
    """Strengths from a tolerance's to 1, in three of five sessions, beside effects of which none looks like them."""
    plans = list(islice(draw.draw_plans(5), 300))
    strengths = [measure_strength(e, v) for plan in plans for e, v in plan.small.items()]
    assert 0.1 - 1e-3 <= min(strengths) < 0.12
    assert 0.9 < max(strengths) <= 1 + 1e-3
    assert np.histogram(np.log(strengths), 5)[0].min() > 20
    assert 0.5 < np.mean([bool(plan.small) for plan in plans]) < 0.7
    for plan in plans:
        together = plan.known | set(plan.small)
        assert len(together) == len(plan.known) + len(plan.small)
        assert all(not (group & set(plan.small)) or len(group & together) < 2 for group in LOOK_ALIKES)


def test_rates_of_single_effects() -> None:
    """Four sessions: nothing found; right as a rival; wrong with confidence; wrong without."""
    coulomb, alike = {"rail_x.coulomb": {"force": 0.3}}, cause("rail_x.bias", rivals=[("rail.tilt", 0.4)])
    cases = [
        session(0, "single", {"command.delay": {"delay": 0.008}}, finding()),
        session(1, "single", {"rail.tilt": {"angle": 0.03}}, finding(alike)),
        session(2, "single", coulomb, finding(cause("air.drag", 0.95))),
        session(3, "single", coulomb, finding(cause("air.drag", 0.8))),
    ]  # fmt: skip
    rates = table(cases)
    assert rates["one effect: named first"] == "0.0 % (0 of 4)"
    assert rates["one effect: named or in the reported group"] == "25.0 % (1 of 4)"
    # Session 1's group holds the truth, session 3's claim is below 0.9: only session 2 is confidently wrong.
    assert rates["confidently wrong"] == "25.0 % (1 of 4)"


def test_rates_of_other_kinds() -> None:
    """Pairs need both, no-effect sessions must name nothing, aliens must be flagged and not misnamed."""
    two = {"rail_x.viscous": {"damping": 0.4}, "command.delay": {"delay": 0.01}}
    alien = {"alien.cogging": {"force": 0.5, "period": 0.2}}
    cases = [
        session(0, "two", two, finding(cause("command.delay"), cause("rail_x.viscous"))),
        session(1, "two", two, finding(cause("command.delay"))),
        session(2, "two", two, finding(cause("servo.lag"), cause("command.delay"), cause("rail_x.viscous"))),
        session(3, "none", {}, finding()),
        session(4, "none", {}, finding(cause("air.drag", 0.7))),
        session(5, "alien", alien, finding(left=True)),
        session(6, "alien", alien, finding(cause("rail_x.tight_spot", 0.95), left=True)),
        session(7, "alien", alien, None),
    ]
    rates = table(cases)
    assert rates["two effects: both named"] == "33.3 % (1 of 3)"  # in session 2 the first named is not there
    assert rates["two effects: both named or in a group"] == "66.7 % (2 of 3)"
    assert rates["no effect: something named"] == "50.0 % (1 of 2)"
    assert rates["outside the catalogue: flagged unexplained"] == "66.7 % (2 of 3)"
    assert rates["outside the catalogue: misnamed with confidence"] == "33.3 % (1 of 3)"
    assert rates["confidently wrong"] == "20.0 % (1 of 5)"  # aliens have a row of their own
    assert rates["diagnosis failed"] == "12.5 % (1 of 8)"


def test_small_deviations_are_neither_asked_for_nor_wrong() -> None:
    """Named first, alone or as a rival they count on neither side; what is neither hidden nor small is still wrong."""
    coulomb, small = {"rail_x.coulomb": {"force": 0.3}}, {"rail.tilt": {"angle": 0.015}}
    alike = cause("rail_x.bias", rivals=[("rail.tilt", 0.4)])
    cases = [
        session(0, "single", coulomb, finding(cause("rail.tilt"), cause("rail_x.coulomb")), small=small),
        session(1, "single", coulomb, finding(alike, cause("rail_x.coulomb")), small=small),
        session(2, "single", coulomb, finding(alike)),
        session(3, "none", {}, finding(cause("rail.tilt")), small=small),
        session(4, "none", {}, finding(left=True), small=small),
        session(5, "none", {}, finding(cause("air.drag")), small=small),
    ]
    rates = table(cases)
    assert rates["one effect: named first"] == "66.7 % (2 of 3)"
    assert rates["no effect: something named"] == "33.3 % (1 of 3)"
    assert rates["confidently wrong"] == "33.3 % (2 of 6)"  # sessions 2 and 5
    assert rates["no effect, nor a small one: something said to be unexplained"] == "-"


def test_another_form_counts_as_its_nearest_effect() -> None:
    """Creep is dry friction: right if named so, with viscous friction beside it too, as viscous friction alone not."""
    creep = {"form.creep": {"force": 0.3, "velocity": 0.04}}
    cases = [
        session(0, "form", creep, finding(cause("rail_x.coulomb"))),
        session(1, "form", creep, finding(cause("rail_x.viscous"), cause("rail_x.coulomb"))),
        session(2, "form", creep, finding(cause("rail_x.viscous"))),
        session(3, "form", creep, finding(cause("air.drag"))),
    ]
    rates = table(cases)
    assert rates["one effect whose law differs from ours: named first"] == "50.0 % (2 of 4)"
    assert rates["confidently wrong"] == "25.0 % (1 of 4)"
    assert cases[0].plan.form == "form.creep, nearest rail_x.coulomb"


def test_a_flight_separates_what_the_true_fit_shows_and_tells_apart() -> None:
    """The oracle decides: 4 sigma from nothing, 3 from the nearest rival."""
    truth, right = {"rail_x.spring": {"stiffness": 0.6, "rest": 0.0}}, finding(cause("rail_x.spring"))
    seen = finding(cause("rail_x.spring", value=0.6, std=0.1, rivals=[("carriage.mass", 3.5)]))
    alike = finding(cause("rail_x.spring", value=0.6, std=0.1, rivals=[("carriage.mass", 2.0)]))
    faint = finding(cause("rail_x.spring", value=0.6, std=0.2))
    cases = [session(i, "single", truth, right, oracle) for i, oracle in enumerate((seen, alike, faint))]
    assert [case.separable for case in cases] == [True, False, False]
    assert session(3, "single", truth, right).separable is None
    assert table(cases)["one effect, a separating flight exists: named first"] == "100.0 % (1 of 1)"


def test_strengths_are_held_against_what_the_rig_has() -> None:
    """The rig's own friction counts as part of the truth; the interval is 1.645 std."""
    truth = true_size("rail_x.coulomb", "force", 0.3, 3)
    cases = []
    for number, (off, std) in enumerate([(0.02, 0.02), (-0.02, 0.01), (0.04, 0.03)]):
        named = case.Named("rail_x.coulomb", 0.99, 1.0, {"force": fitted(truth + off, std)}, {})
        found = case.Finding([named], False, "", (9.0, 1.0), [], "", 30.0)
        cases.append(session(number, "single", {"rail_x.coulomb": {"force": 0.3}}, found))
    error, inside = rates.measure_parameters(cases)
    # Errors are 0.02, 0.02 and 0.04 N: the median over the truth. 0.02 > 1.645 * 0.01, the others lie inside.
    assert error.text.startswith(f"{100 * 0.02 / truth:.1f} %")
    assert (inside.hits, inside.of) == (2, 3)


def test_gain_is_held_against_the_true_structure() -> None:
    """Held-out chi2 9 -> 2 where the truth reaches 1: 7 of 8. Nothing is said where the truth gains nothing either."""
    truth = {"rail_x.coulomb": {"force": 0.3}}
    good = session(0, "single", truth, finding(cause("rail_x.coulomb"), chi2=(9.0, 2.0)), finding(chi2=(9.0, 1.0)))
    idle = session(1, "single", truth, finding(), finding(chi2=(1.02, 1.01)))
    assert good.relative_gain == pytest.approx(7 / 8)
    assert idle.relative_gain is None
    assert table([good, idle])["held-out gain over the oracle's: median"].startswith("0.875")


def test_wilsons_interval() -> None:
    """8 of 10: 49 to 94 % (Brown, Cai and DasGupta 2001); none of 20: below 16.1 %."""
    assert rates.Rate("", 8, 10).interval == pytest.approx((0.490, 0.943), abs=1e-3)
    assert rates.Rate("", 0, 20).interval == pytest.approx((0.0, 0.161), abs=1e-3)
    # A line names what was hidden, what was said, and a claim that is wrong.
    truth = {"rail_x.coulomb": {"force": 0.3}}
    cases = [
        session(0, "single", truth, finding(cause("rail_x.coulomb"))),
        session(1, "single", truth, finding(cause("air.drag"))),
        session(2, "none", {}, finding()),
    ]
    (line,) = rates.list_failures(cases)
    assert "rail_x.coulomb" in line
    assert "air.drag 0.99" in line
    assert line.endswith("CONFIDENTLY WRONG")


def test_results_are_read_back_as_they_were(tmp_path: Path) -> None:
    """Cases survive the file, which is valid JSON even where numbers are missing."""
    cases = [
        session(1, "single", {"rail_x.coulomb": {"force": 0.3}}, finding(cause("rail_x.coulomb")), finding()),
        session(0, "none", {}, None),
    ]
    cases[0] = replace(
        cases[0], commit="abc", plan=replace(cases[0].plan, wind=Wind("field", 2.0, 0.5, (1.0, 2.0, 0.5)))
    )
    campaign.write_results(tmp_path / "out.json", {"seed": 1}, cases)
    content = json.loads((tmp_path / "out.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert [case.Case.from_dict(c) for c in content["cases"]] == cases[::-1]


def test_a_rerun_goes_on_from_its_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sessions in the file are not run again, failed ones are; a file of another seed is refused."""
    ran: list[int] = []

    def run_campaign(plans: list, *_: object) -> Iterator:
        for plan in plans:
            ran.append(plan.number)
            error = "broken" if plan.number == 2 and ran.count(2) == 1 else ""
            yield case.Case(plan, None if error else finding(), error=error)

    monkeypatch.setattr(hidden_effects, "run_campaign", run_campaign)
    monkeypatch.setattr(hidden_effects, "read_commit", lambda: "a" * 40)
    out = ["--json", str(tmp_path / "out.json")]
    hidden_effects.main(["--cases", "4", "--seed", "3", *out])
    hidden_effects.main(["--cases", "5", "--seed", "3", *out])
    assert ran == [0, 1, 2, 3, 2, 4]
    assert [c["plan"]["number"] for c in json.loads((tmp_path / "out.json").read_text())["cases"]] == [0, 1, 2, 3, 4]
    with pytest.raises(SystemExit, match="seed 3"):
        hidden_effects.main(["--cases", "5", "--seed", "4", *out])
    monkeypatch.setattr(hidden_effects, "read_commit", lambda: "b" * 40)
    with pytest.raises(SystemExit, match="5 at aaaaaaaaa, 1 at bbbbbbbbb"):
        hidden_effects.main(["--cases", "6", "--seed", "3", *out])
    hidden_effects.main(["--cases", "6", "--seed", "3", "--mixed", *out])
    with pytest.raises(SystemExit, match="several versions"):
        hidden_effects.main(["--report", str(tmp_path / "out.json")])
    hidden_effects.main(["--report", str(tmp_path / "out.json"), "--mixed"])
    assert hidden_effects.choose_plans(hidden_effects.parse(["--cases", "5", "--seed", "3", "--shard", "2/2"])) == [
        draw.draw_plan(3, number) for number in (1, 3)
    ]


def test_a_commit_says_whether_the_code_was_changed(tmp_path: Path) -> None:
    """The checkout's commit; marked where code differs from it, not where only results do; nothing outside git."""
    assert commits.read_commit(tmp_path) == ""

    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=tmp_path, check=True)

    (tmp_path / "benchmarks/results").mkdir(parents=True)
    (tmp_path / "benchmarks/run.py").write_text("1")
    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "-m", "first")
    (tmp_path / "benchmarks/results/night.json").write_text("{}")
    clean = commits.read_commit(tmp_path)
    assert len(clean) == 40
    (tmp_path / "benchmarks/run.py").write_text("2")
    assert commits.read_commit(tmp_path) == clean + "+changes"
    plan = draw.Plan(0, "none")
    assert commits.find_mixture([case.Case(plan, None, commit=clean)] * 2) == ""
    assert "changes" in commits.find_mixture([case.Case(plan, None, commit=clean + "+changes")])
    assert "not recorded" in commits.find_mixture([case.Case(plan, None)])


def test_confusion_counts_families() -> None:
    """A delay blamed for friction is one count at (horizontal rail, servo and timing)."""
    cases = [
        session(0, "single", {"rail_x.coulomb": {"force": 0.3}}, finding(cause("command.delay"))),
        session(1, "alien", {"alien.crosswind": {"gain": 0.2}}, finding(left=True)),
        session(2, "none", {}, finding()),
    ]
    labels, counts = pictures.confuse(cases)
    assert counts[labels.index("horizontal rail"), labels.index("servo and timing")] == 1
    assert counts[labels.index("unexplained"), labels.index("unexplained")] == 1
    assert counts[labels.index("nothing"), labels.index("nothing")] == 1
    assert counts.sum() == 3
    assert {pictures.family(effect) for effect in draw.FLYING} == set(pictures.FAMILIES)


def test_pictures_are_drawn(tmp_path: Path) -> None:
    """Two files, not empty, the same for the same data."""
    cases = [session(0, "single", {"rail_x.coulomb": {"force": 0.3}}, finding(cause("rail_x.coulomb")))]
    first = [path.read_bytes() for path in pictures.draw_pictures(cases, tmp_path)]
    assert [path.read_bytes() for path in pictures.draw_pictures(cases, tmp_path)] == first
    assert all(b"<svg" in content for content in first)


def test_costs_go_to_whoever_called() -> None:
    """The 2 s of numpy count where it was called from: 1.5 s in the likelihood, 0.5 s in the reader of logs."""
    algebra = (str(costs.PACKAGE / "diagnosis/search/likelihood.py"), 1, "whiten")
    reading = (str(costs.PACKAGE / "logs/read.py"), 1, "read")
    numpy = ("~", 0, "<built-in method numpy>")
    stats = {
        algebra: (1, 1, 1.0, 2.5, {}),
        reading: (1, 1, 0.25, 0.75, {}),
        numpy: (4, 4, 2.0, 2.0, {algebra: (3, 3, 1.5, 1.5), reading: (1, 1, 0.5, 0.5)}),
    }
    assert costs.share_out(stats) == pytest.approx({costs.FITS: 2.5, "reading logs": 0.75})


def rate(name: str, hits: int, of: int) -> Any:  # noqa: ANN401
    """A made-up rate."""
    return rates.Rate(name, hits, of)


@pytest.mark.parametrize(
    ("name", "hits", "of", "broken"),
    [
        ("one effect: named or in the reported group", 46, 46, False),
        ("one effect: named or in the reported group", 40, 46, False),  # 87 % where 90 % is asked: 31 % of such nights
        ("one effect: named or in the reported group", 36, 46, True),  # 78 %: 1 %
        ("confidently wrong", 2, 93, False),
        ("confidently wrong", 14, 93, True),  # 15 % where 5 % is allowed
        ("diagnosis failed", 0, 100, False),
        ("diagnosis failed", 1, 100, True),
        ("two effects: both named", 0, 0, False),
        ("a measure without a bound", 0, 100, False),
    ],
)
def test_bounds_are_broken_beyond_chance(name: str, hits: int, of: int, broken: bool) -> None:
    """A rate that chance gives a diagnosis at the bound in less than 2.5 % of nights; nothing may fail at all."""
    found = rates.find_broken([rate(name, hits, of), rates.Figure(name, "1 s")])
    assert bool(found) is broken
    assert all(name in line for line in found)


def test_every_bound_is_of_a_measure_and_kept_on_record() -> None:
    """Bounds are names of measures, and the sessions of the seed that is published keep them all."""
    record = json.loads((BENCHMARKS / "results/hidden_51959.json").read_text())
    rows = rates.summarise([case.Case.from_dict(content) for content in record["cases"]])
    assert set(rates.BOUNDS) <= {row.name for row in rows}
    assert rates.find_broken(rows) == []


def test_the_night_tells_by_its_exit_status(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    """0 where bounds hold, 1 where not; sessions are not told one by one, the seed is its own, no oracle is asked."""
    asked = []
    for failed, status in ((False, 0), (True, 1)):

        def run(options: Any, plans: list, failed: bool = failed) -> list:  # noqa: ANN401
            asked.append((options.seed, options.oracle, len(plans)))
            return [
                session(p.number, p.kind, p.hidden, None if failed else finding(*map(cause, p.known))) for p in plans
            ]

        monkeypatch.setattr(hidden_effects, "run", run)
        assert hidden_effects.main(["--nightly", "--cases", "3", "--seed", "1"]) == status
        told = capsys.readouterr().out
        assert "not named as hidden" not in told
        assert ("diagnosis failed: 100.0 % (3 of 3)" in told) is failed
    assert asked == [(hidden_effects.NIGHTLY, False, 3)] * 2


def test_competition_figures() -> None:
    """Detection, false alarms, isolation and Brier score of six sessions, by hand."""
    tilt = {"rail.tilt": {"angle": 0.03}}
    cases = [
        session(0, "single", tilt, finding(cause("rail.tilt", 0.9)), wind=Wind("steps")),
        session(1, "single", tilt, finding(cause("rail_x.bias", 0.6, [("rail.tilt", 1.0), ("air.drag", 2.0)]))),
        session(2, "single", tilt, finding()),
        session(3, "alien", {"alien.slosh": {"mass": 0.08, "frequency": 1.0}}, finding(left=True)),
        session(4, "none", {}, finding()),
        session(5, "none", {}, finding(left=True)),
    ]
    # Session 1: half of the 0.4 that the cause leaves is the truth's. Session 2 detects nothing, 3 has no name.
    assert scores.list_isolations(cases) == pytest.approx([0.9, 0.2])
    detection, alarms, isolation, claimed, brier = scores.score(cases)
    assert (detection.hits, detection.of) == (3, 4)
    assert (alarms.hits, alarms.of) == (1, 2)
    assert isolation.text == "0.550 (2 sessions)"
    assert claimed.text == f"{(0.1**2 + 0.6**2) / 2:.4f} (2)"
    assert brier.text == f"{(0.1**2 + 0.6**2 + 0.8**2 + 1.0**2) / 4:.4f} (4)"
    assert scores.format_reliability(cases).splitlines()[2:] == [
        "| 60.0 % | 0.0 % (0 of 1) | 0-79 % |",
        "| 90.0 % | 100.0 % (1 of 1) | 21-100 % |",
    ]


def test_rates_are_broken_down_by_any_attribute() -> None:
    """By kind of gusts, and by what only some sessions have; an attribute that none has gives no table."""
    tilt = {"rail.tilt": {"angle": 0.03}}
    cases = [
        session(0, "single", tilt, finding(cause("rail.tilt")), wind=Wind("steps", 2.0)),
        session(1, "single", tilt, finding(cause("air.drag"))),
        session(2, "alien", {"alien.slosh": {"mass": 0.08, "frequency": 1.0}}, finding(left=True)),
    ]
    assert {name: len(group) for name, group in scores.group_by(cases, "gusts").items()} == {"ou": 2, "steps": 1}
    assert list(scores.group_by(cases, "gust_strength")) == ["0.65 to 1.39 % of weight", "1.39 to 3 % of weight"]
    assert list(scores.group_by(cases, "outside")) == ["memory"]
    assert scores.group_by([replace(cases[0], commit="c")], "commit") == {"c": [replace(cases[0], commit="c")]}
    lines = scores.format_groups(cases, "gusts").splitlines()
    assert lines[0].startswith("| gusts | sessions | one: named first |")
    assert lines[2].startswith("| ou | 2 | 0 of 1 | 0 of 1 | 1 of 1 | 1 of 1 |")  # confidently wrong, outside flagged
    assert scores.format_groups(cases, "form") == ""


@pytest.mark.slow
def test_a_small_night_breaks_nothing(tmp_path: Path) -> None:
    """Three of its sessions, flown and diagnosed."""
    assert (
        hidden_effects.main(["--nightly", "--cases", "3", "--jobs", "1", "--json", str(tmp_path / "night.json")]) == 0
    )
