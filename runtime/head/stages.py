"""From a scan to its labels, but for belief: the stages of a runner that are made for one sensor."""

from dataclasses import dataclass, replace

import numpy as np

from runtime.bundle.choice import Choice
from runtime.bundle.loading import Bundle
from runtime.compute.sessions import Execution, provider_name
from runtime.compute.workers import Workers
from runtime.head.networks import Network, open_network
from runtime.head.refiners import Refiner, choose_refiner
from runtime.image.inputs import Inputs
from runtime.image.making import make_inputs
from runtime.recordings.poses import Pose, relative_pose
from runtime.settings import RunnerSettings


@dataclass(frozen=True)
class Stages:
    """With memory laid out for its images."""

    choice: Choice
    inputs: Inputs
    network: Network
    postprocess: str  # what `refiner` does
    refiner: Refiner

    @classmethod
    def of(cls, bundle: Bundle, choice: Choice, settings: RunnerSettings, precision: str, workers: Workers) -> "Stages":
        """Lay out memory for a sensor and compile or load what is needed. Raises what `open_network` and
        `choose_refiner` do."""
        sensor, carrier = choice.entry, (settings.nearest, settings.body)
        view = bundle.manifest.view(sensor)
        inputs = make_inputs(view, workers, sensor.reach, *carrier, choice.mounting)
        execution = Execution(settings.providers, settings.allow_fallback, settings.session_options)
        network = open_network(bundle, precision, view, workers, execution)
        started = [one for one in settings.providers or () if provider_name(one) in network.providers]
        execution = replace(execution, providers=started, allow_fallback=False)
        postprocess, refiner = choose_refiner(bundle, sensor.decision, settings, workers, execution)
        return cls(choice, inputs, network, postprocess, refiner)

    def serve(self, choice: Choice) -> bool:
        """Whether they are made for that sensor, mounted so."""
        same = self.choice.mounting is None if choice.mounting is None else self.choice.mounting is choice.mounting
        return same and self.choice.entry == choice.entry

    def pose(self, pose: Pose) -> Pose:
        """T_world_sensor of T_world_scan."""
        mounting = self.choice.mounting
        return pose if mounting is None else pose @ relative_pose(mounting, np.eye(4))
