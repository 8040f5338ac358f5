"""How a network is trained: one frozen description, stored in its checkpoint."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from mos_model.data.augment import ANY_SENSOR, PAPER, SIM2REAL, Augmentation
from runtime.errors import SettingError
from runtime.typed_json import build

OPTIMIZERS = ("sgd", "adam", "adamw")
SCHEDULES = ("decay", "cosine")
PUBLISHED_EPOCH = 957  # batches of 20 in the 19,130 training frames; simulated streets have no end
PRECISIONS = ("auto", "fp32", "bf16", "fp16")


@dataclass(frozen=True)
class TrainConfig:
    """Default: the paper's first stage (Sec. III-E), for epochs of 957 batches of 20 (19,130 frames)."""

    recipe: str = "paper"
    stage: int = 1  # 1: image network; 2: point head, with the image network frozen
    seed: int = 0
    steps: int = 150 * PUBLISHED_EPOCH
    batch: int = 20  # samples a step, of each process
    crop: int = 0  # columns; 0: whole images
    crop_on_moving: float = 0.0  # share of the crops that hold a mover
    mixed: bool = False  # simulated drives of all sensors, mountings and places, see `mos_model.data.mixture`
    mix: int = 8  # groups of samples (frames, streets) that are shuffled together
    optimizer: str = "sgd"
    learning_rate: float = 0.01
    momentum: float = 0.9  # SGD
    weight_decay: float = 1e-4
    schedule: str = "decay"  # "decay": times `decay` every `decay_every` steps; "cosine": down to 0 at the last step
    warmup: int = PUBLISHED_EPOCH  # steps of linear growth at the start
    decay: float = 0.99
    decay_every: int = PUBLISHED_EPOCH  # steps
    clip: float = 0.0  # largest norm of the gradient; 0: any
    freeze_norm: bool = False  # BatchNorm keeps the running statistics of the weights that training starts from
    ema: float = 0.0  # decay of the moving average of the weights, which is what is saved; 0: none
    class_weights: str = "inverse_sqrt"  # or "inverse": see losses.class_weights
    weight_samples: int = 256  # training samples whose classes are counted for them
    precision: str = "auto"
    augmentation: Augmentation = field(default_factory=lambda: PAPER)
    street_frames: int = 8  # scans of a simulated street that become samples
    street_every: int = 2  # scans between them
    crops: int = 2  # of each frame, where images are cropped
    validate_every: int = 500  # steps
    validation_streets: int = 8  # simulated streets of the validation
    validation_frames: int = 3  # of each of them

    def __post_init__(self) -> None:
        for name, values in (("optimizer", OPTIMIZERS), ("schedule", SCHEDULES), ("precision", PRECISIONS)):
            if getattr(self, name) not in values:
                raise SettingError(f"{name} must be one of {', '.join(values)}, not {getattr(self, name)!r}")
        if self.stage not in (1, 2):
            raise SettingError(f"stage must be 1 or 2, not {self.stage!r}")
        for name in (
            "steps",
            "batch",
            "mix",
            "decay_every",
            "validate_every",
            "street_frames",
            "street_every",
        ):
            if getattr(self, name) < 1:
                raise SettingError(f"{name} must be at least 1, not {getattr(self, name)!r}")
        if not self.learning_rate > 0 or not 0 <= self.ema < 1 or self.warmup < 0 or self.clip < 0:
            raise SettingError("learning_rate must be positive, ema within 0..1, warmup and clip not negative")

    def learning_rate_at(self, step: int) -> float:
        """Learning rate of step 0, 1, ...; a function of the step, so that nothing needs to be resumed."""
        rate = self.learning_rate * min(1.0, (step + 1) / max(1, self.warmup))
        after = max(0, step - self.warmup)
        if self.schedule == "decay":
            return rate * self.decay ** (after // self.decay_every)
        return rate * 0.5 * (1 + math.cos(math.pi * min(1.0, after / max(1, self.steps - self.warmup))))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"augmentation": asdict(self.augmentation) | {"shift": list(self.augmentation.shift)}}


def recipe(name: str, stage: int = 1, epoch_steps: int = PUBLISHED_EPOCH, **changes: Any) -> TrainConfig:
    """A recipe by name, with changes of its fields ("augmentation.yaw": a field of the augmentation).

    "paper": as published; an epoch has `epoch_steps` steps. "sim2real": for small budgets and simulated
    streets; "any-sensor": the same for drives of all sensors, from weights that know one. Raises SettingError for a
    field that there is not, or a value that it cannot have.
    """
    if name == "paper" and stage == 1:
        config = TrainConfig(steps=150 * epoch_steps, warmup=epoch_steps, decay_every=epoch_steps)
    elif name == "paper":
        config = TrainConfig(
            stage=stage,
            steps=10 * epoch_steps,
            batch=1,
            optimizer="adam",
            learning_rate=0.001,
            weight_decay=0.0,
            warmup=0,
            decay=0.95,
            decay_every=1000,
        )
    elif name in ("sim2real", "any-sensor"):
        config = TrainConfig(
            recipe=name,
            stage=stage,
            steps=8000 if stage == 1 else 1500,
            batch=4 if stage == 1 else 2,
            crop=512,
            crop_on_moving=0.5,
            optimizer="adamw",
            learning_rate=0.003 if stage == 1 else 0.002,
            weight_decay=0.01,
            schedule="cosine",
            warmup=150,
            clip=10.0,
            ema=0.998,
            street_frames=10,
            crops=3,
            augmentation=SIM2REAL,
        )
        if name == "any-sensor":
            config = replace(
                config, mixed=True, mix=12, street_frames=8, crops=4 if stage == 1 else 3, freeze_norm=True,
                learning_rate=0.5 * config.learning_rate, augmentation=ANY_SENSOR,
                validation_streets=24, validation_frames=2, validate_every=1000,
            )  # fmt: skip
    else:
        raise SettingError(f"there is no recipe {name!r}: choose 'paper', 'sim2real' or 'any-sensor'")
    return _changed(config, changes)


def _changed(config: TrainConfig, changes: Mapping[str, Any]) -> TrainConfig:
    settings = config.to_dict()
    for name, value in changes.items():
        group, _, inner = name.partition(".")
        if inner and isinstance(settings.get(group), dict):
            settings[group][inner] = value
        else:
            settings[name] = value
    return build(TrainConfig, settings, "training")
