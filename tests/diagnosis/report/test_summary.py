"""The sentences made of a verdict, and its errors as tables."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.builders import AFTER, BEFORE, CAUSE, VERDICT
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.noise import NoiseFloor
from vpptwin.diagnosis.judgement.verdict import Cause, Estimate, Experiment, Misfit, Rival, Unexplained, Verdict
from vpptwin.effects import CATALOGUE, Effect
from vpptwin.report.error_table import tabulate_errors
from vpptwin.report.summary import Summary, describe_share, describe_size, summarise
from vpptwin.report.words import format_digits, format_value

SILENT = NoiseFloor({}, {})
NOISE = NoiseFloor({"position_rmse_m": 0.000566, "angle_rmse_rad": 0.003, "θ rate": 0.0063}, {"θ rate": "rad/s"})
SURE = replace(CAUSE, also_explained_by=[], confidence=0.999)


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (0.3081, 0.0123, "N", "0.308 ± 0.012 N"),  # a leading 1 keeps two digits of the deviation
        (0.3081, 0.0423, "N", "0.31 ± 0.04 N"), (-0.3081, 0.0073, "N", "-0.308 ± 0.007 N"),
        (12.34, 3.2, "N", "12 ± 3 N"), (1234.5, 250.0, "N", "1234 ± 250 N"),
        (0.0123, 0.00096, "N", "0.0123 ± 0.0010 N"),  # 0.00096 rounds to 0.001
        (0.123456, 0.0, "N", "0.1235 N"), (0.123456, float("nan"), "N", "0.1235 N"),
        (0.123456, float("inf"), "N", "0.1235 N"), (0.0123, 0.0004, "s", "12.3 ± 0.4 ms"),
        (1.2, 0.03, "s", "1.20 ± 0.03 s"), (0.95, 0.02, "", "0.95 ± 0.02"),
    ],
)  # fmt: skip
def test_values_have_the_digits_that_mean_something(value: float, std: float, unit: str, text: str) -> None:
    """Rounded to the deviation's first digit; without a deviation four digits; small times in milliseconds."""
    assert format_value(Estimate(value, unit, std, 0.0)) == text


def accuse(effect: Effect, value: float = 0.31, std: float = 0.01) -> Cause:
    """A cause with nothing beside it."""
    parameters = {p.name: Estimate(value, p.unit, std, p.off) for p in effect.parameters}
    return Cause(effect.id, 0.9, parameters, 0.94, [], effect.summary)


@pytest.mark.parametrize(
    ("effect", "phrase"),
    [
        ("rail_x.coulomb", "dry friction of 0.310 ± 0.010 N on the horizontal rail"),
        ("servo.trim", "blades that are not trimmed (offset_1 0.310 ± 0.010 rad, offset_2 0.310 ± 0.010 rad)"),
        ("rail_x.spring", "an elastic force of 0.310 ± 0.010 N/m on the horizontal rail (rest 0.310 ± 0.010 m)"),
        ("airframe.mass", "a wrong mass of the craft (+0.310 ± 0.010 kg)"),
        ("rotor.thrust_gain", "a wrong thrust constant of the rotors (gain 0.310 ± 0.010, in the twin 1)"),
        ("airframe.com", "a centre of mass beside the hinge (0.310 ± 0.010 m)"),
        ("gyro.bias", "a bias of the gyro (0.310 ± 0.010 rad/s)"),
        ("rail_x.tight_spot", "a tight spot of 0.310 ± 0.010 N on the horizontal rail"),  # its place is in the report
    ],
)  # fmt: skip
def test_a_cause_and_its_size_in_words(effect: str, phrase: str) -> None:
    """What, how much with its unit, what the twin has instead."""
    assert describe_size(accuse(next(e for e in CATALOGUE if e.id == effect)), {}, brief=True) == phrase


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.id)
def test_every_effect_has_a_size(effect: Effect) -> None:
    """With its unit, once for every parameter."""
    phrase = describe_size(accuse(effect), {})
    assert phrase.count("0.310 ± 0.010") == len(effect.parameters)
    assert "  " not in phrase


def test_a_twin_that_has_some_already() -> None:
    """The size says how much the twin has, in the unit of the value."""
    friction = replace(SURE, parameters={"force": Estimate(0.3081, "N", 0.0123, 0.2)})
    assert describe_size(friction, {}).endswith("0.308 ± 0.012 N on the horizontal rail (in the twin 0.2 N)")
    lag = Cause("servo.lag", 0.9, {"t": Estimate(0.028, "s", 0.001, 0.02)}, 0.3, [], "a wrong time constant")
    assert describe_size(lag, {}) == "a wrong time constant (28.0 ± 1.0 ms, in the twin 20 ms)"


RAIL = "Dry friction of 0.308 ± 0.012 N on the horizontal rail"
DELAY = Cause("motor.delay", 0.999, {"delay": Estimate(0.019, "s", 0.0005, 0.0)}, 0.2, [], "a delay of actuator motor")
GAIN = Cause("m2.gain", 0.999, {"gain": Estimate(0.856, "", 0.005, 1.0)}, 0.2, [], "a wrong gain of actuator m2")
FALLS = "the error half a second ahead from 10 to 4 mm and from 40 to 20 mrad (held-out data of 2 logs)"


@pytest.mark.parametrize(
    ("causes", "told"),
    [
        ([SURE], f"{RAIL} takes {FALLS}."),
        ([SURE, DELAY], f"{RAIL} and a delay of actuator motor (19.0 ± 0.5 ms) together take {FALLS}."),
        ([GAIN], f"Correcting a wrong gain of actuator m2 (0.856 ± 0.005, in the twin 1) takes {FALLS}."),
        ([replace(SURE, confidence=0.89, kind_confidence=0.9)], f"{RAIL} (89 % probable) takes {FALLS}."),
        ([replace(SURE, confidence=0.44)], f"{RAIL} (44 % probable) takes {FALLS}."),
        ([replace(DELAY, confidence=0.44)], f"A delay of actuator motor (19.0 ± 0.5 ms; 44 % probable) takes {FALLS}."),
        (
            [replace(SURE, confidence=0.6, kind="dry friction", kind_confidence=0.98)],
            f"{RAIL} (law not certain) takes {FALLS}.",
        ),
    ],
)
def test_the_headline_says_what_all_causes_remove_together(causes: list[Cause], told: str) -> None:
    """In units of the pose, half a second ahead, on held-out data; and how probable what is not sure is."""
    assert read(replace(VERDICT, causes=causes)).headline == told


def test_one_place_is_told_once() -> None:
    """Of causes that act there together."""
    drag = replace(SURE, effect="rail_x.viscous", summary="viscous friction on the horizontal rail")
    told = read(replace(VERDICT, causes=[SURE, drag, DELAY])).headline
    assert told.startswith(
        "Dry friction of 0.308 ± 0.012 N, viscous friction of 0.308 ± 0.012 N on the horizontal rail and a delay of"
    )


def test_many_causes_are_counted() -> None:
    """Three are named."""
    many = [SURE, *(replace(DELAY, effect=f"m{i}.delay") for i in range(4))]
    assert " and 2 more together take the error" in read(replace(VERDICT, causes=many)).headline


def test_one_log_is_named() -> None:
    """Its stretches are held out in turn."""
    assert read(replace(VERDICT, logs=["logs/run_1.mcap"])).headline.endswith("(held-out stretches of run_1).")


def test_an_error_that_stays_one_second_ahead_is_told() -> None:
    """A share of the squared error near by must not stand for it."""
    assert read(replace(VERDICT, causes=[SURE])).more == []
    far = replace(VERDICT, causes=[SURE], after=replace(AFTER, position_rmse_m=[0.001, 0.001, 0.002, 0.004, 0.018]))
    assert read(far).more == ["One second ahead it goes from 20 to 18 mm."]


def test_what_shows_elsewhere_is_told_there() -> None:
    """Where errors change at another horizon, in rates alone, or not at all."""
    same = replace(BEFORE, chi2=1.1)
    near = replace(same, position_rmse_m=[0.0005, *(BEFORE.position_rmse_m or [])[1:]])
    told = read(replace(VERDICT, causes=[SURE], after=near))
    assert told.headline == f"{RAIL} takes the error 0.05 s ahead from 1 to 0.5 mm (held-out data of 2 logs)."
    rates = replace(same, velocity_rmse={"θ rate": [1, 2, 3, 2, 5.0]})
    told = read(replace(VERDICT, causes=[SURE], after=rates))
    assert "takes the error half a second ahead from 4 to 2 rad/s" in told.headline
    told = read(replace(VERDICT, causes=[replace(SURE, blows=8)], after=same))
    assert told.headline == (
        f"{RAIL} hardly changes the error half a second ahead, 10 mm and 40 mrad (held-out data of 2 logs); "
        "8 impacts show it."
    )


def test_a_change_may_be_chance() -> None:
    """Where its 90 % interval has both signs."""
    change = {"position_rmse_m": [(-0.8, 0.1)] * 5, "angle_rmse_rad": [(-0.8, 0.1)] * 5}
    assert ", perhaps by chance (held-out" in read(replace(VERDICT, improvement=change)).headline
    assert "chance" not in read(replace(VERDICT, improvement=change | {"angle_rmse_rad": [(-0.8, -0.1)] * 5})).headline


@pytest.mark.parametrize("chi2", [1.65, 85.0, 9e4, float("nan")])
def test_an_error_far_above_noise_is_never_called_explained(chi2: float) -> None:
    """Whatever stands out or does not: above the floor no sentence says that nothing is wrong."""
    verdict = replace(VERDICT, causes=[], after=replace(AFTER, chi2=chi2))
    assert read(verdict).headline == (
        "No cause was found: the error half a second ahead, 10 mm and 40 mrad, is more than sensor noise makes "
        "(held-out data of 2 logs)."
    )
    left = read(replace(verdict, causes=[SURE])).remains
    assert left.endswith(f"over short windows it is {format_digits(chi2**0.5)} times the sensor noise.")


MISFIT = Misfit(9.2195, "elbow", 0.1, 0.3612, "rad")
FAR = replace(VERDICT, causes=[], after=replace(AFTER, chi2=85.0), misfit=MISFIT)


@pytest.mark.parametrize(
    ("misfit", "words"),
    [
        (MISFIT, ", largest in elbow, where it shows from 0.1 s ahead on."),
        (replace(MISFIT, horizon_s=None), ", largest in elbow."),
        (replace(MISFIT, horizon_s=1.0), ", largest in elbow, where it shows one second ahead only."),
        (replace(MISFIT, rmse=float("inf")), ", largest in elbow, whose simulation diverges."),
        (replace(MISFIT, joint=""), "."),
    ],
)
def test_every_misfit_has_its_words(misfit: Misfit, words: str) -> None:
    """How far above the noise, in which joint, from which horizon on; what helps comes first all the same."""
    told = read(replace(FAR, misfit=misfit, causes=[SURE]))
    assert told.remains == (
        "What remains is 4 mm and 20 mrad half a second ahead. No candidate explains it; over short windows it is 9.22 "
        f"times the sensor noise{words}"
    )
    assert told.headline.startswith(RAIL)


def test_a_misfit_comes_with_what_would_help() -> None:
    """One sentence: an effect of one's own where something follows a quantity, else the log; without a misfit none."""
    assert summarise(VERDICT, NOISE, {}).remedy == ""
    assert "check unit, sign, scale, zero and stamps of elbow" in summarise(FAR, NOISE, {}).remedy
    built = replace(MISFIT, within=["quad.com", "m3.gain", "m2.gain", "m4.gain", "m1.gain"], explained=0.55)
    told = summarise(replace(FAR, misfit=built), NOISE, {}).remedy
    assert "quad.com, m3.gain, m2.gain and m4.gain may be off within" in told
    assert "together make most of it, so" in told
    nearly = replace(FAR, misfit=replace(built, explained=0.93))
    assert "together make it, so" in summarise(nearly, NOISE, {}).remedy
    assert "none of them is named" in told
    breeze = replace(FAR, unexplained=Unexplained(False, 1.0, None, [], 0.0, 0.0071))
    assert (
        "perhaps nothing, because a random force of 0.71 % of what drives a joint"
        in summarise(breeze, NOISE, {}).remedy
    )
    soon = replace(breeze, misfit=replace(MISFIT, horizon_s=HORIZONS_S[0]))
    assert "at so short a horizon" in summarise(soon, NOISE, {}).remedy
    left = Unexplained(True, 0.4, "elbow", ["elbow velocity"], 7.0, 0.03)
    follows = summarise(replace(FAR, unexplained=left), NOISE, {}).remedy
    assert "an effect of your own, because the missing force follows elbow velocity" in follows
    for verdict in (FAR, soon, replace(FAR, unexplained=left)):
        assert summarise(verdict, NOISE, {}).remedy.count(".") == 1


def test_what_remains_in_words() -> None:
    """Like noise, like a random force, or like something that follows a quantity, in the headline's units."""
    head = "What remains is 4 mm and 20 mrad half a second ahead."
    assert read(VERDICT).remains == f"{head} It is consistent with noise and disturbances."
    left = Unexplained(True, 0.24, "force on rail_x", ["rail_x position", "rail_x velocity"], 5.13)
    random = Unexplained(True, 0.4, "elbow", [], 0.3, 0.032)
    for unexplained, told in (
        (left, "It follows rail_x position and rail_x velocity."),
        (replace(left, depends_on=[]), "It has structure that no effect explains, mostly in force on rail_x."),
        (random, "It acts like a random force of 3.2 % of what drives joint elbow, more than disturbances usually do."),
        (replace(random, force=1.0), "It acts like a random force as strong as what drives joint elbow, more than "
                                     "disturbances usually do."),
    ):  # fmt: skip
        assert read(replace(VERDICT, unexplained=unexplained)).remains == f"{head} {told}"
    little = Unexplained(False, 0.01, None, [], 0.0, 0.004)
    loud = read(replace(VERDICT, unexplained=little, after=replace(AFTER, chi2=3.0))).remains
    assert loud == f"{head} It acts like a random force of 0.4 % of what drives a joint, as disturbances do."


def test_words_are_true_for_every_rig() -> None:
    """A cart is not flown and no wind blows on it; shares stay in the report."""
    left = Unexplained(True, 0.24, "slide", ["slide position"], 5.13)
    for causes in ([], [SURE]):
        for unexplained in (VERDICT.unexplained, left):
            for score in (AFTER, BEFORE):
                verdict = replace(VERDICT, causes=causes, unexplained=unexplained, after=score)
                for each in (verdict, replace(verdict, misfit=MISFIT)):
                    told = " ".join(read(each).lines)
                    assert [word for word in ("flight", "gust", "of the error", "sigma", "24 %") if word in told] == []


def test_without_a_cause_the_headline_tells_two_cases_apart() -> None:
    """Nothing wrong, or wrong in a way that no effect explains."""
    told = read(replace(VERDICT, causes=[], gap=False))
    assert told.lines == [
        "Nothing is wrong that these data show: the error half a second ahead, 10 mm and 40 mrad, is consistent with "
        "sensor noise and disturbances (held-out data of 2 logs)."
    ]
    odd = replace(VERDICT, causes=[], unexplained=Unexplained(True, 1.0, "x", ["rail_x position"]))
    assert read(odd).headline.startswith("Something is wrong that no known effect explains: the error half a second")
    assert read(odd).remains == "It follows rail_x position."


def read(verdict: Verdict) -> Summary:
    """Its sentences."""
    return summarise(verdict, NOISE, {"air.drag": "aerodynamic drag on the craft"})


def rival(effect: str, confidence: float, value: float, kind: str, summary: str) -> Rival:
    """One with a size."""
    return Rival(effect, confidence, 0.4, {"force": Estimate(value, "N", 0.05, 0.0)}, summary, kind)


def test_rivals_stand_beside_their_cause_with_their_sizes() -> None:
    """Those of its kind in its row, others a row for each kind; none that is faint, nothing, or a cause itself."""
    rivals = [
        rival("rail_x.viscous", 0.07, 0.5, "damping", "viscous friction on the horizontal rail"),
        rival("rail_x.stiction", 0.31, 0.31, "dry friction", "breakaway friction on the horizontal rail"),
        Rival("air.drag", 0.06),
        rival("rail_x.bias", 0.2, 0.04, "", "a constant force on the horizontal rail"),  # 0.04 ± 0.05 N
        rival("rail_x.spring", 0.02, 0.5, "", "an elastic force on the horizontal rail"),
        rival("motor.delay", 0.4, 0.5, "a late response", "a delay of actuator motor"),
        rival("rail_z.coulomb", 0.09, 0.5, "dry friction", "dry friction on the vertical guide"),
        rival("rail_z.stiction", 0.08, 0.5, "dry friction", "breakaway friction on the vertical guide"),
    ]
    cause = replace(SURE, also_explained_by=rivals, confidence=0.55, kind="dry friction", kind_confidence=0.86)
    first, second = read(replace(VERDICT, causes=[cause, DELAY])).rows
    assert (first.effects, second.effects) == ("rail_x.coulomb", "motor.delay")
    assert first.text == (
        "Dry friction of 0.308 ± 0.012 N on the horizontal rail, 55 % probable · or breakaway friction of "
        "0.31 ± 0.05 N, 31 % (dry friction of any law: 86 %)"
    )
    assert first.instead == [
        "or instead dry friction of 0.50 ± 0.05 N on the vertical guide, 9 % · or breakaway friction of "
        "0.50 ± 0.05 N, 8 %",
        "or instead viscous friction of 0.50 ± 0.05 N, 7 %", "or instead aerodynamic drag on the craft, 6 %",
    ]  # fmt: skip
    assert (second.text, second.instead) == ("A delay of actuator motor (19.0 ± 0.5 ms), 99.9 % probable", [])


def test_causes_of_one_kind_share_a_row() -> None:
    """As dry friction of two laws on one rail does."""
    laws = [replace(SURE, kind="dry friction"), replace(
        SURE, effect="rail_x.stiction", summary="breakaway friction on the horizontal rail", kind="dry friction"
    )]  # fmt: skip
    (row,) = read(replace(VERDICT, causes=laws)).rows
    assert row.effects == "rail_x.coulomb, rail_x.stiction"
    assert row.text.endswith("horizontal rail, 99.9 % probable · and breakaway friction of 0.308 ± 0.012 N, 99.9 %")


def test_weak_causes_are_folded_away() -> None:
    """They are in no line; but if the twin with them has half the error, the headline names that twin."""
    faint = replace(DELAY, confidence=0.0988, weak=True)
    verdict = replace(VERDICT, causes=[SURE, faint], suggested=replace(AFTER, chi2=1.0))
    assert read(verdict).lines == read(replace(VERDICT, causes=[SURE])).lines
    assert read(verdict).weak == ["a delay of actuator motor (19.0 ± 0.5 ms; 10 % probable)"]
    alone = replace(verdict, causes=[faint], after=BEFORE, suggested=AFTER)
    told = read(alone)
    assert told.headline == (
        "Not in twin.yaml, but in twin_suggested.yaml: a delay of actuator motor (19.0 ± 0.5 ms; 10 % "
        f"probable) takes {FALLS}."
    )
    assert told.lines == [told.headline]
    assert read(replace(alone, misfit=MISFIT)).lines == [told.headline]
    assert not replace(alone, suggested=replace(BEFORE, chi2=1.0)).suggests


def test_shares_of_the_error() -> None:
    """Slightly more, where the fit ends below the noise floor, is all of it; none where hardly anything was there."""
    assert describe_share(SURE, 8.9) == "62 %"
    assert describe_share(replace(SURE, gain=1.12), 8.9) == "100 %"
    assert describe_share(replace(SURE, gain=0.12, gain_interval=(-0.05, 0.3)), 8.9) == "12 % (−5 to 30 %)"
    assert describe_share(replace(SURE, gain=8e6), 0.9) == "-"
    assert describe_share(replace(SURE, blows=8), 0.9) == "62 % in 8 impacts"


def test_the_next_experiment_in_words() -> None:
    """What it separates, and how clearly."""
    told = Experiment("x_steps", {"size": 0.5}, ["servo.lag", "command.delay"], 5.24, "vpptwin fly")
    summary = summarise(replace(VERDICT, experiment=told), NOISE, {"servo.lag": "a slow servo"})
    expected = (
        "x_steps (size 0.5): it is predicted to separate a slow servo (servo.lag) and command.delay by 5.2 sigma."
    )
    assert summary.experiment == expected
    assert read(VERDICT).experiment is None


def test_tables_are_in_thousandths() -> None:
    """Three digits; no second column without a second score; no table of positions on a rig without slides."""
    position, angle, rate = tabulate_errors(BEFORE, AFTER, NOISE)
    assert (position.quantity, position.unit, position.noise) == ("position", "mm", "0.566")
    assert (position.rows[-1].horizon, position.rows[-1].before, position.rows[-1].after) == ("1 s", "20", "4.9")
    assert (angle.rows[0].before, angle.unit) == ("10", "mrad")
    assert (rate.rows[2].before, rate.rows[2].after, rate.unit) == ("3000", "1000", "mrad/s")
    assert len(position.rows) == len(HORIZONS_S)
    (only, *_) = tabulate_errors(replace(BEFORE, position_rmse_m=None), None, SILENT)
    assert (only.quantity, only.rows[4].before, only.rows[4].after, only.noise) == ("angle", "50", "", "")
    # By more than 2 % at some horizon; without a second score all is worth a look.
    slightly = replace(BEFORE, angle_rmse_rad=[1.01 * error for error in BEFORE.angle_rmse_rad or []])
    changed = {table.quantity: table.changed for table in tabulate_errors(BEFORE, slightly, NOISE)}
    assert changed == {"position": False, "angle": False, "θ rate": False}
    later = replace(slightly, angle_rmse_rad=[*(slightly.angle_rmse_rad or [])[:-1], 0.9])
    assert [table.quantity for table in tabulate_errors(BEFORE, later, NOISE) if table.changed] == ["angle"]
    assert all(table.changed for table in tabulate_errors(BEFORE, None, NOISE))


def test_large_numbers_have_no_exponent() -> None:
    """Three digits all the same."""
    assert [format_digits(value) for value in (575123.0, 1234.0, 999.4, 0.01234)] == [
        "575,000",
        "1,230",
        "999",
        "0.0123",
    ]
    assert format_digits(float("inf")) == "inf"


def test_no_value_is_a_negative_zero() -> None:
    """-0.04 ± 0.4 N is 0.0 ± 0.4 N."""
    assert format_value(Estimate(-0.04, "N", 0.4, 0.0)) == "0.0 ± 0.4 N"
