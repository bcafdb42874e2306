"""check: random missions of all formats against an independent judge, which looks at points every 20 cm."""

import pytest

from tests.paths.missions.trial import Court, Trial, make_maps

NUM_QUICK, NUM_SLOW = 100, 500


@pytest.fixture(scope="module")
def court(tmp_path_factory) -> Court:
    """The worlds and their maps, made once."""
    folder = tmp_path_factory.mktemp("worlds")
    make_maps(folder)
    return Court(folder)


def assert_lawful(trial: Trial) -> None:
    """Check that no contact and nothing unknown is clean, and that no finding is invented."""
    case = trial.case
    about = (
        f"mission {trial.number} ({case.kind}, {case.suffix}, {case.world.name}): {trial.verdict}"
    )
    assert trial.verdict.state != "crashed", about
    assert not trial.ruling.false_clean, f"{trial.ruling.false_clean}; {about}"
    assert not trial.ruling.invented, f"{trial.ruling.invented}; {about}"


@pytest.mark.parametrize("first", range(0, NUM_QUICK, 20))
def test_random_missions_keep_the_law(court, first):
    trials = [court.trial(number) for number in range(first, first + 20)]
    for trial in trials:
        assert_lawful(trial)
    assert {"clean", "findings"} <= {trial.verdict.state for trial in trials}


@pytest.mark.slow
@pytest.mark.parametrize("first", range(NUM_QUICK, NUM_QUICK + NUM_SLOW, 50))
def test_more_random_missions_keep_the_law(court, first):
    for number in range(first, first + 50):
        assert_lawful(court.trial(number))
