"""The sensors by their names, one line each."""

import hashlib
from pathlib import Path

from runtime.errors import SettingError
from runtime.sensors import hesai, ouster, robosense, velodyne
from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import Sensor
from runtime.typed_json import build, read_json

SENSORS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        velodyne.HDL64E,
        velodyne.HDL32E,
        velodyne.VLP16,
        velodyne.VLP32C,
        velodyne.VLS128,
        *ouster.OS0,
        *ouster.OS1,
        *ouster.OS2,
        hesai.PANDAR40P,
        hesai.PANDAR64,
        hesai.XT16,
        hesai.XT32,
        hesai.QT64,
        robosense.RS16,
        robosense.RS32,
        robosense.RUBY,
    )
}

DEFAULT_SENSOR = velodyne.HDL64E.name  # that of SemanticKITTI, for which the published networks were made


def find_sensor(sensor: str | Sensor) -> Sensor:
    """The sensor of that name, or the sensor itself. Raises SettingError for an unknown name."""
    if isinstance(sensor, Sensor):
        return sensor
    if sensor not in SENSORS:
        raise SettingError(f"unknown sensor {sensor!r}; known are {', '.join(SENSORS)}")
    return SENSORS[sensor]


def open_sensor(sensor: str | Path | Sensor) -> Sensor:
    """A sensor by its name, from a JSON file whose entries are the fields of `Sensor`, or the sensor itself.

    Raises SettingError for an unknown name, and for a file that is no such thing, saying where.
    """
    if isinstance(sensor, str | Path) and Path(sensor).suffix.lower() == ".json":
        return build(Sensor, read_json(Path(sensor), SettingError), str(sensor))
    if isinstance(sensor, str | Sensor):
        return find_sensor(sensor)
    raise SettingError(f"a sensor is a name, a JSON file or a Sensor, not {sensor!r:.60}")


def told_apart(sensor: Sensor) -> str:
    """The name of a sensor; of one that is not known by it, with a checksum of what it is."""
    if sensor == SENSORS.get(sensor.name):
        return sensor.name
    return f"{sensor.name} {hashlib.sha256(repr(sensor).encode()).hexdigest()[:12]}"


def name_of(image: RangeImage) -> str | None:
    """The sensor whose field of view a range image shows; None where it is of none. Rows and columns may be others."""
    view = image.fov_up, image.fov_down
    known = ((name, sensor.range_image) for name, sensor in SENSORS.items())
    return next((name for name, its in known if (its.fov_up, its.fov_down) == view), None)
