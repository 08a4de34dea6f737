# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg
import geometry_msgs.msg
import std_msgs.msg

class BatteryState:
    POWER_SUPPLY_STATUS_UNKNOWN: ClassVar[int]
    POWER_SUPPLY_STATUS_CHARGING: ClassVar[int]
    POWER_SUPPLY_STATUS_DISCHARGING: ClassVar[int]
    POWER_SUPPLY_STATUS_NOT_CHARGING: ClassVar[int]
    POWER_SUPPLY_STATUS_FULL: ClassVar[int]
    POWER_SUPPLY_HEALTH_UNKNOWN: ClassVar[int]
    POWER_SUPPLY_HEALTH_GOOD: ClassVar[int]
    POWER_SUPPLY_HEALTH_OVERHEAT: ClassVar[int]
    POWER_SUPPLY_HEALTH_DEAD: ClassVar[int]
    POWER_SUPPLY_HEALTH_OVERVOLTAGE: ClassVar[int]
    POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: ClassVar[int]
    POWER_SUPPLY_HEALTH_COLD: ClassVar[int]
    POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: ClassVar[int]
    POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_UNKNOWN: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_NIMH: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_LION: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_LIPO: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_LIFE: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_NICD: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_LIMN: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_TERNARY: ClassVar[int]
    POWER_SUPPLY_TECHNOLOGY_VRLA: ClassVar[int]
    header: std_msgs.msg.Header
    voltage: float
    temperature: float
    current: float
    charge: float
    capacity: float
    design_capacity: float
    percentage: float
    power_supply_status: int
    power_supply_health: int
    power_supply_technology: int
    present: bool
    cell_voltage: Any
    cell_temperature: Any
    location: str
    serial_number: str
    def __init__(self, *, header: std_msgs.msg.Header = ..., voltage: float = ..., temperature: float = ..., current: float = ..., charge: float = ..., capacity: float = ..., design_capacity: float = ..., percentage: float = ..., power_supply_status: int = ..., power_supply_health: int = ..., power_supply_technology: int = ..., present: bool = ..., cell_voltage: Any = ..., cell_temperature: Any = ..., location: str = ..., serial_number: str = ...) -> None: ...

class CameraInfo:
    header: std_msgs.msg.Header
    height: int
    width: int
    distortion_model: str
    d: Any
    k: Any
    r: Any
    p: Any
    binning_x: int
    binning_y: int
    roi: RegionOfInterest
    def __init__(self, *, header: std_msgs.msg.Header = ..., height: int = ..., width: int = ..., distortion_model: str = ..., d: Any = ..., k: Any = ..., r: Any = ..., p: Any = ..., binning_x: int = ..., binning_y: int = ..., roi: RegionOfInterest = ...) -> None: ...

class ChannelFloat32:
    name: str
    values: Any
    def __init__(self, *, name: str = ..., values: Any = ...) -> None: ...

class CompressedImage:
    header: std_msgs.msg.Header
    format: str
    data: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., format: str = ..., data: Any = ...) -> None: ...

class FluidPressure:
    header: std_msgs.msg.Header
    fluid_pressure: float
    variance: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., fluid_pressure: float = ..., variance: float = ...) -> None: ...

class Illuminance:
    header: std_msgs.msg.Header
    illuminance: float
    variance: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., illuminance: float = ..., variance: float = ...) -> None: ...

class Image:
    header: std_msgs.msg.Header
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., height: int = ..., width: int = ..., encoding: str = ..., is_bigendian: int = ..., step: int = ..., data: Any = ...) -> None: ...

class Imu:
    header: std_msgs.msg.Header
    orientation: geometry_msgs.msg.Quaternion
    orientation_covariance: Any
    angular_velocity: geometry_msgs.msg.Vector3
    angular_velocity_covariance: Any
    linear_acceleration: geometry_msgs.msg.Vector3
    linear_acceleration_covariance: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., orientation: geometry_msgs.msg.Quaternion = ..., orientation_covariance: Any = ..., angular_velocity: geometry_msgs.msg.Vector3 = ..., angular_velocity_covariance: Any = ..., linear_acceleration: geometry_msgs.msg.Vector3 = ..., linear_acceleration_covariance: Any = ...) -> None: ...

class JointState:
    header: std_msgs.msg.Header
    name: Sequence[str]
    position: Any
    velocity: Any
    effort: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., name: Sequence[str] = ..., position: Any = ..., velocity: Any = ..., effort: Any = ...) -> None: ...

class Joy:
    header: std_msgs.msg.Header
    axes: Any
    buttons: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., axes: Any = ..., buttons: Any = ...) -> None: ...

class JoyFeedback:
    TYPE_LED: ClassVar[int]
    TYPE_RUMBLE: ClassVar[int]
    TYPE_BUZZER: ClassVar[int]
    type: int
    id: int
    intensity: float
    def __init__(self, *, type: int = ..., id: int = ..., intensity: float = ...) -> None: ...

class JoyFeedbackArray:
    array: Sequence[JoyFeedback]
    def __init__(self, *, array: Sequence[JoyFeedback] = ...) -> None: ...

class LaserEcho:
    echoes: Any
    def __init__(self, *, echoes: Any = ...) -> None: ...

class LaserScan:
    header: std_msgs.msg.Header
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: Any
    intensities: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., angle_min: float = ..., angle_max: float = ..., angle_increment: float = ..., time_increment: float = ..., scan_time: float = ..., range_min: float = ..., range_max: float = ..., ranges: Any = ..., intensities: Any = ...) -> None: ...

class MagneticField:
    header: std_msgs.msg.Header
    magnetic_field: geometry_msgs.msg.Vector3
    magnetic_field_covariance: Any
    def __init__(self, *, header: std_msgs.msg.Header = ..., magnetic_field: geometry_msgs.msg.Vector3 = ..., magnetic_field_covariance: Any = ...) -> None: ...

class MultiDOFJointState:
    header: std_msgs.msg.Header
    joint_names: Sequence[str]
    transforms: Sequence[geometry_msgs.msg.Transform]
    twist: Sequence[geometry_msgs.msg.Twist]
    wrench: Sequence[geometry_msgs.msg.Wrench]
    def __init__(self, *, header: std_msgs.msg.Header = ..., joint_names: Sequence[str] = ..., transforms: Sequence[geometry_msgs.msg.Transform] = ..., twist: Sequence[geometry_msgs.msg.Twist] = ..., wrench: Sequence[geometry_msgs.msg.Wrench] = ...) -> None: ...

class MultiEchoLaserScan:
    header: std_msgs.msg.Header
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: Sequence[LaserEcho]
    intensities: Sequence[LaserEcho]
    def __init__(self, *, header: std_msgs.msg.Header = ..., angle_min: float = ..., angle_max: float = ..., angle_increment: float = ..., time_increment: float = ..., scan_time: float = ..., range_min: float = ..., range_max: float = ..., ranges: Sequence[LaserEcho] = ..., intensities: Sequence[LaserEcho] = ...) -> None: ...

class NavSatFix:
    COVARIANCE_TYPE_UNKNOWN: ClassVar[int]
    COVARIANCE_TYPE_APPROXIMATED: ClassVar[int]
    COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[int]
    COVARIANCE_TYPE_KNOWN: ClassVar[int]
    header: std_msgs.msg.Header
    status: NavSatStatus
    latitude: float
    longitude: float
    altitude: float
    position_covariance: Any
    position_covariance_type: int
    def __init__(self, *, header: std_msgs.msg.Header = ..., status: NavSatStatus = ..., latitude: float = ..., longitude: float = ..., altitude: float = ..., position_covariance: Any = ..., position_covariance_type: int = ...) -> None: ...

class NavSatStatus:
    STATUS_UNKNOWN: ClassVar[int]
    STATUS_NO_FIX: ClassVar[int]
    STATUS_FIX: ClassVar[int]
    STATUS_SBAS_FIX: ClassVar[int]
    STATUS_GBAS_FIX: ClassVar[int]
    SERVICE_UNKNOWN: ClassVar[int]
    SERVICE_GPS: ClassVar[int]
    SERVICE_GLONASS: ClassVar[int]
    SERVICE_COMPASS: ClassVar[int]
    SERVICE_GALILEO: ClassVar[int]
    status: int
    service: int
    def __init__(self, *, status: int = ..., service: int = ...) -> None: ...

class PointCloud:
    header: std_msgs.msg.Header
    points: Sequence[geometry_msgs.msg.Point32]
    channels: Sequence[ChannelFloat32]
    def __init__(self, *, header: std_msgs.msg.Header = ..., points: Sequence[geometry_msgs.msg.Point32] = ..., channels: Sequence[ChannelFloat32] = ...) -> None: ...

class PointCloud2:
    header: std_msgs.msg.Header
    height: int
    width: int
    fields: Sequence[PointField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any
    is_dense: bool
    def __init__(self, *, header: std_msgs.msg.Header = ..., height: int = ..., width: int = ..., fields: Sequence[PointField] = ..., is_bigendian: bool = ..., point_step: int = ..., row_step: int = ..., data: Any = ..., is_dense: bool = ...) -> None: ...

class PointField:
    INT8: ClassVar[int]
    UINT8: ClassVar[int]
    INT16: ClassVar[int]
    UINT16: ClassVar[int]
    INT32: ClassVar[int]
    UINT32: ClassVar[int]
    FLOAT32: ClassVar[int]
    FLOAT64: ClassVar[int]
    name: str
    offset: int
    datatype: int
    count: int
    def __init__(self, *, name: str = ..., offset: int = ..., datatype: int = ..., count: int = ...) -> None: ...

class Range:
    ULTRASOUND: ClassVar[int]
    INFRARED: ClassVar[int]
    header: std_msgs.msg.Header
    radiation_type: int
    field_of_view: float
    min_range: float
    max_range: float
    range: float
    variance: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., radiation_type: int = ..., field_of_view: float = ..., min_range: float = ..., max_range: float = ..., range: float = ..., variance: float = ...) -> None: ...

class RegionOfInterest:
    x_offset: int
    y_offset: int
    height: int
    width: int
    do_rectify: bool
    def __init__(self, *, x_offset: int = ..., y_offset: int = ..., height: int = ..., width: int = ..., do_rectify: bool = ...) -> None: ...

class RelativeHumidity:
    header: std_msgs.msg.Header
    relative_humidity: float
    variance: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., relative_humidity: float = ..., variance: float = ...) -> None: ...

class Temperature:
    header: std_msgs.msg.Header
    temperature: float
    variance: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., temperature: float = ..., variance: float = ...) -> None: ...

class TimeReference:
    header: std_msgs.msg.Header
    time_ref: builtin_interfaces.msg.Time
    source: str
    def __init__(self, *, header: std_msgs.msg.Header = ..., time_ref: builtin_interfaces.msg.Time = ..., source: str = ...) -> None: ...
