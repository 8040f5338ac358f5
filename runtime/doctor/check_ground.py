"""How is the sensor mounted: how high over the ground, and how level? Does z point up, and is the unit a metre?"""

from collections.abc import Sequence
from math import hypot

from runtime.doctor.findings import Finding
from runtime.doctor.ground import Ground
from runtime.doctor.sample import Sample, middle
from runtime.sensors.sensor import Sensor

USUAL = Sensor.mount_height  # m over the ground: of the sensors that networks are trained with
LOWER, HIGHER = 0.3, 1.3  # m below and above it that cost few points of IoU (README, Limits)
TOP = 4.5  # m over the ground where no car carries a sensor; in feet, the roof of any car is there
LEVEL, TILTED = 2.5, 6.0  # degrees that cost few points, and more than cars have (up to 4), or streets for long
OVER = 120.0  # degrees from which on it is upside down, and below that, down to 180 - OVER, on its side
CLEARLY, VASTLY = 0.2, 0.3  # share of the near points on a plane from which on a slant, or one above, is believed
LOW = 1.0  # m, height over a slant that may be a table or a ramp
ROOF = 1.2  # m, at least, of a ground above the sensor; the ceiling of a room is nearer, or its floor is in sight too
STEEPLY = 0.1  # share of the points steeply above and below a sensor on its side; of one that is not, beside a wall, 0


def check_ground(samples: Sequence[Sample]) -> Finding:
    """The ground that most samples show; each has usable points."""
    grounds = [(ground, sample.steep) for sample in samples if (ground := sample.ground) is not None]
    turned = [ground for ground, steep in grounds if _is_turned(ground, steep)]
    under = [ground for ground, _ in grounds if ground.tilt <= 180 - OVER]
    if 2 * len(turned) > len(samples):
        tilt = middle(ground.tilt for ground in turned)
        text = f"a large plane lies {'above the sensor: upside down' if tilt > OVER else 'beside it, tilted by'}"
        side = "" if tilt > OVER else f" {tilt:.0f} degrees"
        return Finding("bad", "ground", f"{text}{side}; the network needs x forward, y left, z up")
    if 2 * len(under) <= len(samples):
        return Finding("ok", "ground", "none in sight, so that height and level of the sensor are not known")
    return _judge(under)


def _is_turned(ground: Ground, steep: float) -> bool:
    """Whether the ground lies above the sensor or beside it."""
    if ground.tilt > OVER:
        return ground.support > VASTLY and ground.height > ROOF
    return ground.tilt > 180 - OVER and steep > STEEPLY


def _judge(grounds: Sequence[Ground]) -> Finding:
    height = middle(ground.height for ground in grounds)
    pitch, roll = middle(ground.pitch for ground in grounds), middle(ground.roll for ground in grounds)
    tilt, clear = hypot(pitch, roll), middle(ground.support for ground in grounds) > CLEARLY
    text = f"{height:.2f} m below the sensor, which looks {abs(pitch):.1f} degrees {'up' if pitch > 0 else 'down'} and "
    text += f"leans {abs(roll):.1f} degrees to the {'right' if roll > 0 else 'left'}"
    if height > TOP:
        return Finding("bad", "ground", f"{text}: are these metres? The network was trained at {USUAL} m")
    if tilt > TILTED and clear and height > LOW:
        return Finding("bad", "ground", f"{text}: turn points and poses level, x forward, y left, z up")
    if tilt > LEVEL:
        return Finding("warn", "ground", f"{text}: the network was trained with a level sensor")
    if not USUAL - LOWER <= height <= USUAL + HIGHER:
        return Finding("warn", "ground", f"{text}: the network was trained at {USUAL} m")
    return Finding("ok", "ground", text)
