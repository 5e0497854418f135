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
from vpptwin.report.summary import describe_cause, describe_certainty, describe_unexplained, headline, summarise
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


def accuse(effect: Effect, value: float = 0.31, std: float = 0.01, gain: float = 0.94) -> Cause:
    """A cause with nothing beside it."""
    parameters = {p.name: Estimate(value, p.unit, std, p.off) for p in effect.parameters}
    return Cause(effect.id, 0.9, parameters, gain, [], effect.summary)


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ("rail_x.coulomb", "Dry friction of 0.310 ± 0.010 N on the horizontal rail, which the twin lacks, explains"),
        ("servo.trim", "Blades that are not trimmed, offset_1 0.310 ± 0.010 rad and offset_2 0.310 ± 0.010 rad, which "
                       "the twin lacks, explain"),
        ("rail_x.spring", "An elastic force of 0.310 ± 0.010 N/m on the horizontal rail (rest 0.310 ± 0.010 m), which "
                          "the twin lacks, explains"),
        ("airframe.mass", "A wrong mass of the craft, +0.310 ± 0.010 kg, explains"),
        ("rotor.thrust_gain", "A wrong thrust constant of the rotors, gain 0.310 ± 0.010, where the twin has 1, "
                              "explains"),
        ("airframe.com", "A centre of mass beside the hinge, 0.310 ± 0.010 m, which the twin lacks, explains"),
        ("gyro.bias", "A bias of the gyro, 0.310 ± 0.010 rad/s, which the twin lacks, explains"),
    ],
)  # fmt: skip
def test_the_sentence_names_cause_size_and_share(effect: str, sentence: str) -> None:
    """What, how much with its unit, what the twin has instead, which share of the error."""
    assert describe_cause(accuse(next(e for e in CATALOGUE if e.id == effect)), {}) == f"{sentence} 94 % of the error."


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.id)
def test_every_effect_makes_a_sentence(effect: Effect) -> None:
    """Size and unit are in it once, and it is one sentence."""
    sentence = describe_cause(accuse(effect), {})
    assert sentence.count("0.310 ± 0.010") == len(effect.parameters)
    assert sentence.endswith(" 94 % of the error.")
    assert sentence[0].isupper()
    assert ".." not in sentence
    assert "  " not in sentence


def test_a_twin_that_has_some_already() -> None:
    """The sentence says how much the twin has, in the unit of the value."""
    friction = replace(SURE, parameters={"force": Estimate(0.3081, "N", 0.0123, 0.2)})
    assert ", where the twin has 0.2 N, explains" in describe_cause(friction, {})
    lag = Cause("servo.lag", 0.9, {"t": Estimate(0.028, "s", 0.001, 0.02)}, 0.3, [], "a wrong time constant")
    assert "28.0 ± 1.0 ms, where the twin has 20 ms," in describe_cause(lag, {})


def test_a_share_is_between_nothing_and_all() -> None:
    """Slightly more, where the fit ends below the noise floor, is all of the error; nothing is clipped silently."""
    assert describe_cause(replace(SURE, gain=1.12), {}, 8.9).endswith(", explains all of the error.")
    harmful = describe_cause(replace(SURE, gain=-0.1), {})
    assert harmful.endswith(" does not reduce the error on held-out data.")
    for gain in (0.0, -0.004, 0.004):
        assert describe_cause(replace(SURE, gain=gain), {}).endswith(
            " changes the error on held-out data by less than 1 %."
        )
    below = describe_cause(replace(SURE, gain=8e6), {}, chi2=0.9)
    assert below.endswith("held-out data, which hardly exceeded the assumed noise.")
    assert "%" not in below
    doubtful = replace(SURE, gain=0.12, gain_interval=(-0.05, 0.3))
    assert describe_cause(doubtful, {}).endswith(
        "explains 12 % of the error, perhaps by chance (90 % interval −5 to 30 %)."
    )
    assert "chance" not in describe_cause(replace(SURE, gain_interval=(0.5, 0.7)), {})


def test_what_a_share_is_of_is_said_beside_it() -> None:
    """Wherever a percentage of the error stands, and only there."""
    assert "held-out excess chi²" in summarise(VERDICT, NOISE, {}).share
    assert summarise(replace(VERDICT, causes=[]), NOISE, {}).share == ""


@pytest.mark.parametrize("chi2", [1.65, 85.0, 9e4, float("nan")])
def test_an_error_far_above_noise_is_never_called_explained(chi2: float) -> None:
    """Whatever stands out or does not: above the floor the sentences say how large the error is."""
    verdict = replace(VERDICT, causes=[], after=replace(AFTER, chi2=chi2))
    told = headline(verdict, {}), describe_unexplained(verdict), describe_unexplained(replace(verdict, causes=[SURE]))
    for sentence in told:
        assert f"held-out chi² {format_digits(chi2)}, noise floor 1" in sentence
        assert "no effect is needed" not in sentence
        assert not sentence.startswith("Nothing")
    odd = replace(verdict, unexplained=Unexplained(True, 0.5, "x", []))
    assert describe_unexplained(odd).endswith(
        f"still {chi2**0.5:.3g} times the sensor noise (held-out chi² {format_digits(chi2)}, noise floor 1)."
    )


MISFIT = Misfit(9.2195, "elbow", 0.1, 0.3612, "rad")
FAR = replace(VERDICT, causes=[], after=replace(AFTER, chi2=85.0), misfit=MISFIT)


def test_a_misfit_is_said_first() -> None:
    """How large, in which joint, from which horizon on, the error at 1 s; causes and what would help come after it."""
    assert headline(FAR, {}) == (
        "The error of the twin is 9.22 times the sensor noise (held-out chi² 85, noise floor 1), largest in elbow "
        "from 0.1 s ahead on: 0.361 rad 1 s ahead; no cause was found."
    )
    named = summarise(replace(FAR, causes=[SURE]), NOISE, {})
    assert named.headline.startswith("The error of the twin with rail_x.coulomb is 9.22 times")
    assert named.headline.endswith("0.361 rad 1 s ahead.")
    assert named.others == [describe_cause(SURE, {})]
    assert "held-out excess chi²" in named.share
    assert named.unexplained == "No candidate explains the remaining error."


@pytest.mark.parametrize(
    ("misfit", "words"),
    [
        (replace(MISFIT, horizon_s=None, rmse=0.012, unit="m"), "in elbow: 12 mm 1 s ahead;"),
        (replace(MISFIT, horizon_s=1.0), "in elbow: 0.361 rad 1 s ahead, not before;"),
        (replace(MISFIT, rmse=float("inf")), "in elbow, whose simulation diverges;"),
        (replace(MISFIT, joint=""), "noise floor 1); no cause"),
    ],
)
def test_every_misfit_has_its_words(misfit: Misfit, words: str) -> None:
    """Errors that stand out at no horizon, only at the last, without end, or of a joint that nobody can tell."""
    assert words in headline(replace(FAR, misfit=misfit), {})


def test_a_misfit_comes_with_what_would_help() -> None:
    """One sentence: an effect of one's own where something follows a quantity, else the log; without a misfit none."""
    assert summarise(VERDICT, NOISE, {}).remedy == ""
    assert "check unit, sign, scale, zero and stamps of elbow" in summarise(FAR, NOISE, {}).remedy
    built = replace(MISFIT, within=["quad.com", "m3.gain", "m2.gain", "m4.gain", "m1.gain"], explained=0.55)
    told = summarise(replace(FAR, misfit=built), NOISE, {}).remedy
    assert "quad.com, m3.gain, m2.gain and m4.gain may be off within" in told
    assert "explains 55 % of it, so" in told
    nearly = replace(FAR, misfit=replace(built, explained=0.93))
    assert "explains it, so" in summarise(nearly, NOISE, {}).remedy
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


def test_what_is_left_is_told_as_a_force() -> None:
    """On rigs whose scales a log told: a random force as a share of what drives the joint, and what it follows."""
    random = Unexplained(True, 0.4, "elbow", [], 0.3, 0.032)
    assert describe_unexplained(replace(VERDICT, unexplained=random)) == (
        "Something is unexplained: it acts like a random force of 3.2 % of what drives joint elbow, more than "
        "disturbances usually do."
    )
    follows = replace(random, depends_on=["elbow velocity", "time"])
    assert describe_unexplained(replace(VERDICT, unexplained=follows)).endswith(
        "3.2 % of what drives joint elbow; it follows elbow velocity and time."
    )
    whole = describe_unexplained(replace(VERDICT, unexplained=replace(random, force=1.0)))
    assert "a random force as strong as what drives joint elbow" in whole
    little = Unexplained(False, 0.01, None, [], 0.0, 0.004)
    assert describe_unexplained(replace(VERDICT, unexplained=little)) == (
        "Nothing beyond noise and disturbances is unexplained; the remainder acts like a random force of 0.4 % of "
        "what drives a joint."
    )
    loud = describe_unexplained(replace(VERDICT, unexplained=little, after=replace(AFTER, chi2=3.0)))
    assert loud.startswith("The error is still 1.73 times")
    assert loud.endswith("acts like a random force of 0.4 % of what drives a joint.")


def test_a_cause_beside_something_unexplained_is_suggested() -> None:
    """Up to 0.89 and with something left, no sentence sounds sure; a sure cause or a clean remainder stays as it is."""
    left = Unexplained(True, 0.4, "elbow", [], 7.0, 0.03)
    doubtful = replace(SURE, confidence=0.89)
    for verdict in (
        replace(VERDICT, causes=[doubtful, doubtful], unexplained=left),
        replace(FAR, causes=[doubtful]),
        replace(VERDICT, causes=[doubtful], after=replace(AFTER, chi2=3.0)),
    ):
        summary = summarise(verdict, NOISE, {})
        told = [summary.headline] * (verdict.misfit is None) + summary.others
        assert len(told) == len(verdict.causes)
        assert all(sentence.startswith("Suggested: dry friction of") for sentence in told)
        assert summary.certainty[0].startswith("rail_x.coulomb: 89 % probable, only suggested")
    for sure in (replace(VERDICT, causes=[doubtful]), replace(VERDICT, causes=[SURE], unexplained=left)):
        assert headline(sure, {}).startswith("Dry friction of")
        assert "suggested" not in summarise(sure, NOISE, {}).certainty[0]


def test_words_are_true_for_every_rig() -> None:
    """A cart is not flown and no wind blows on it."""
    left = Unexplained(True, 0.24, "slide", ["slide position"], 5.13)
    for causes in ([], [SURE]):
        for unexplained in (VERDICT.unexplained, left):
            for score in (AFTER, BEFORE):
                verdict = replace(VERDICT, causes=causes, unexplained=unexplained, after=score)
                for each in (verdict, replace(verdict, misfit=MISFIT)):
                    summary = summarise(each, NOISE, {})
                    told = " ".join(
                        [summary.headline, summary.remedy, summary.error, summary.unexplained, summary.share]
                    )
                    assert "flight" not in told
                    assert "gust" not in told


def test_without_a_cause_the_headline_tells_two_cases_apart() -> None:
    """Nothing wrong, or wrong in a way that no effect explains."""
    fine = replace(VERDICT, causes=[], gap=False)
    odd = replace(VERDICT, causes=[], unexplained=Unexplained(True, 1.0, "x", ["rail_x position"]))
    assert "no effect is needed" in headline(fine, {})
    assert "no known effect explains" in headline(odd, {})
    assert headline(VERDICT, {}) == describe_cause(CAUSE, {})


def read(verdict: Verdict) -> list[str]:
    """Its lines on certainty."""
    return summarise(verdict, NOISE, {"air.drag": "aerodynamic drag on the craft"}).certainty


def test_rivals_in_words() -> None:
    """The headline names strong ones, probability and sigma come below, weak ones are counted; ids behind words."""
    rivals = [Rival("air.drag", 0.43, 0.42), Rival("rail_x.viscous", 0.02, 2.9)]
    verdict = replace(VERDICT, causes=[replace(CAUSE, also_explained_by=rivals, confidence=0.55)])
    meanings = {"air.drag": "aerodynamic drag on the craft"}
    also = "; so might aerodynamic drag on the craft (air.drag)."
    assert headline(verdict, meanings).endswith(f"of the error{also}")
    three = [Rival(effect, 0.2, 0.5) for effect in ("air.drag", "rail_x.viscous", "rail_x.stiction")]
    crowd = replace(VERDICT, causes=[replace(CAUSE, also_explained_by=three, confidence=0.4)])
    assert headline(crowd, meanings).endswith("; so might aerodynamic drag on the craft (air.drag) or 2 other effects.")
    sure, others = read(verdict)
    assert sure == "rail_x.coulomb: 55 % probable."
    assert others == (
        "It may instead be aerodynamic drag on the craft (air.drag), 43 % probable, fits worse by 0.4 sigma; or "
        "1 other effect below 5 % each."
    )
    even = replace(VERDICT, causes=[replace(CAUSE, also_explained_by=[Rival("air.drag", 0.5, 0.0)], confidence=0.5)])
    assert "50 % probable, fits equally well" in read(even)[1]
    alone = "rail_x.coulomb: 99.9 % probable; no other effect explains these data as well."
    assert read(replace(VERDICT, causes=[SURE])) == [alone]
    (guess,) = describe_certainty(SURE, {}, suggested=True)
    assert guess.endswith("no other effect explains these data as well, if the assumed noise is right.")


def test_two_causes_are_told_apart() -> None:
    """Each has its own sentence, and its certainty says whose it is."""
    second = replace(SURE, effect="rail_z.coulomb", summary="dry friction on the vertical guide", gain=0.2)
    verdict = replace(VERDICT, causes=[SURE, second])
    assert summarise(verdict, NOISE, {}).others == [describe_cause(second, {})]
    assert [line.split(":")[0] for line in read(verdict)] == ["rail_x.coulomb", "rail_z.coulomb"]


def test_what_is_left_in_words() -> None:
    """Share, significance, where it lives and what it follows; the error before and after, and its noise."""
    left = Unexplained(True, 0.24, "force on rail_x", ["rail_x position", "rail_x velocity"], 5.13)
    assert summarise(VERDICT, NOISE, {}).unexplained.startswith("Nothing")
    assert summarise(replace(VERDICT, unexplained=left), NOISE, {}).unexplained == (
        "24 % of the missing force is unexplained, 5.1 sigma beyond chance, "
        "mostly in force on rail_x; it follows rail_x position and rail_x velocity."
    )
    change = {"position_rmse_m": [(-0.1, 0.02), (-0.2, -0.1), (-0.66, -0.51), (-0.5, -0.4), (-0.3, -0.2)]}
    assert summarise(replace(VERDICT, improvement=change), NOISE, {}).error == (
        "On held-out data, the position error 0.25 s ahead goes from 5 to 2 mm (−66 to −51 %, 90 % "
        "interval); sensor noise alone is 0.566 mm."
    )
    assert "the position error 0.25 s ahead is 5 mm" in summarise(replace(VERDICT, causes=[]), SILENT, {}).error
    told = Experiment("x_steps", {"size": 0.5}, ["servo.lag", "command.delay"], 5.24, "vpptwin fly")
    summary = summarise(replace(VERDICT, experiment=told), NOISE, {"servo.lag": "a slow servo"})
    expected = (
        "x_steps (size 0.5): it is predicted to separate a slow servo (servo.lag) and command.delay by 5.2 sigma."
    )
    assert summary.experiment == expected
    assert summarise(VERDICT, NOISE, {}).experiment is None


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


def test_weak_causes_are_folded_away() -> None:
    """Below 5 % a cause has no sentence in bold and no line on certainty; the report keeps it."""
    faint = replace(SURE, effect="rail_z.coulomb", summary="dry friction on the vertical guide", confidence=0.02)
    summary = summarise(replace(VERDICT, causes=[SURE, faint]), NOISE, {})
    assert summary.others == []
    assert summary.weak == [describe_cause(faint, {})]
    assert [line.split(":")[0] for line in summary.certainty] == ["rail_x.coulomb"]


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
