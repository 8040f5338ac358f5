"""The sensors by their names, one line each."""

from runtime.errors import SettingError
from runtime.sensors import ouster, velodyne
from runtime.sensors.sensor import Sensor

SENSORS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        velodyne.HDL64E,
        velodyne.HDL32E,
        velodyne.VLP16,
        ouster.OS1_32,
        ouster.OS1_64,
        ouster.OS1_128,
    )
}


def find_sensor(sensor: str | Sensor) -> Sensor:
    """The sensor of that name, or the sensor itself. Raises SettingError for an unknown name."""
    if isinstance(sensor, Sensor):
        return sensor
    if sensor not in SENSORS:
        raise SettingError(f"unknown sensor {sensor!r}; known are {', '.join(SENSORS)}")
    return SENSORS[sensor]
