"""Training and validation samples of a run: simulated streets, or a data set on disk."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mos_model.data.augment import NONE
from mos_model.data.dataset import VALIDATION_STREETS, SampleConfig, SimulatedStreets
from mos_model.data.labelled import demand_movers, open_labelled
from mos_model.data.mixture import MixedDrives
from mos_model.data.recorded import RecordedFrames, training_frames, validation_frames
from mos_model.networks.config import ModelConfig
from mos_model.training.recipe import TrainConfig
from mos_model.training.validation import Validation
from runtime.recordings.recording import Options


@dataclass(frozen=True)
class Data:
    """Where the samples come from."""

    root: Path | None = None  # of a data set in the layout of SemanticKITTI; None: simulated streets
    train: tuple[str, ...] = ()  # sequences
    validation: tuple[str, ...] = ()
    frame: str | None = None  # whose poses they have, see `runtime.recordings.recording.Options`

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "root": str(self.root) if self.root else None,
            "train": list(self.train),
            "validation": list(self.validation),
        }


SIMULATED = Data()


def sample_config(model: ModelConfig, config: TrainConfig) -> SampleConfig:
    """How a recipe makes training samples for a network."""
    return SampleConfig.of(
        model,
        augmentation=config.augmentation,
        crop=config.crop,
        crop_on_moving=config.crop_on_moving,
        points=config.stage == 2,
    )


def simulated_data(
    model: ModelConfig, config: TrainConfig, data: Data = SIMULATED
) -> tuple[SimulatedStreets | MixedDrives, Validation]:
    """Training streets, and held-out ones of fixed seeds, whole and as they are."""
    samples = sample_config(model, config)
    drives = MixedDrives if config.mixed else SimulatedStreets
    streets = drives(samples, config.seed, config.street_frames, config.street_every, config.crops)
    held_out = drives(
        replace(samples, augmentation=NONE, crop=0),
        frames=config.validation_frames,
        every=4,
        first_street=VALIDATION_STREETS,
    )
    return streets, Validation(held_out, config.validation_streets, keep=True)


def recorded_data(model: ModelConfig, config: TrainConfig, data: Data) -> tuple[RecordedFrames, Validation | None]:
    """Training and validation frames of a data set on disk, all of it checked."""
    assert data.root is not None
    samples = sample_config(model, config)
    names = tuple(dict.fromkeys(data.train + data.validation))
    opened = open_labelled(data.root, names, model.range_image, Options(frame=data.frame))
    found = dict(zip(names, opened, strict=True))
    train, held_out = ([found[name] for name in wanted] for wanted in (data.train, data.validation))
    demand_movers(train, "training sequences")
    frames = training_frames(samples, train, config.seed, config.crops)
    if not held_out:
        return frames, None
    demand_movers(held_out, "validation sequences")
    whole = validation_frames(replace(samples, augmentation=NONE, crop=0), held_out)
    return frames, Validation(whole, len(whole.frames))
