"""Recipes: the published numbers, and nothing accepted that does not exist."""

import json

import pytest

from mos_model.data.augment import PAPER, SIM2REAL
from mos_model.training.recipe import recipe
from runtime.errors import SettingError


def test_published_first_stage():
    config = recipe("paper", epoch_steps=100)
    assert (config.optimizer, config.batch, config.momentum, config.weight_decay) == ("sgd", 20, 0.9, 1e-4)
    assert config.steps == 150 * 100
    assert config.augmentation == PAPER
    assert config.learning_rate_at(0) == pytest.approx(0.01 / 100)
    assert config.learning_rate_at(49) == pytest.approx(0.005)
    assert config.learning_rate_at(99) == config.learning_rate_at(199) == pytest.approx(0.01)
    assert config.learning_rate_at(200) == pytest.approx(0.0099)
    assert config.learning_rate_at(100 + 100 * 7 + 50) == pytest.approx(0.01 * 0.99**7)


def test_published_second_stage():
    config = recipe("paper", stage=2, epoch_steps=19_130)
    assert (config.optimizer, config.batch, config.stage, config.steps) == ("adam", 1, 2, 191_300)
    assert config.learning_rate_at(999) == pytest.approx(0.001)
    assert config.learning_rate_at(2000) == pytest.approx(0.001 * 0.95**2)


def test_cosine():
    config = recipe("sim2real", steps=1000, warmup=100, learning_rate=0.5)
    rates = [config.learning_rate_at(step) for step in range(1000)]
    assert max(rates) == pytest.approx(0.5)
    assert rates.index(max(rates)) in (99, 100)
    assert rates[550] == pytest.approx(0.25)
    assert rates[-1] < 1e-5


def test_plain_values_and_back():
    config = recipe("sim2real", **{"augmentation.yaw": 90, "steps": 7, "augmentation.shift": [1, 2]})
    assert config.augmentation.yaw == 90
    assert config.augmentation.tilt == SIM2REAL.tilt
    assert recipe("paper", **config.to_dict()) == config
    assert json.loads(json.dumps(config.to_dict())) == config.to_dict()


@pytest.mark.parametrize(
    "changes",
    [
        {"step": 5},
        {"augmentation.spin": 1},
        {"optimizer": "lion"},
        {"batch": 0},
        {"stage": 3},
        {"ema": 1.0},
        {"steps": "many"},
        {"steps": 7.5},
        {"augmentation.yaw": None},
        {"augmentation.shift": [1]},
        {"augmentation.flip": 3},
    ],
)
def test_what_does_not_exist_is_refused(changes):
    with pytest.raises(SettingError):
        recipe("paper", **changes)


def test_unknown_recipe():
    with pytest.raises(SettingError, match="'sim2real' or 'any-sensor'"):
        recipe("best")
