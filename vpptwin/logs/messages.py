"""Definitions of the ROS 2 messages that flight logs are made of, complete as ros2msg text."""

from __future__ import annotations

_BATTERY_CONSTANTS = "\n".join(
    f"uint8 POWER_SUPPLY_{group}_{name} = {value}"
    for group, names in {
        "STATUS": ("UNKNOWN", "CHARGING", "DISCHARGING", "NOT_CHARGING", "FULL"),
        "HEALTH": (
            "UNKNOWN", "GOOD", "OVERHEAT", "DEAD", "OVERVOLTAGE", "UNSPEC_FAILURE", "COLD", "WATCHDOG_TIMER_EXPIRE",
            "SAFETY_TIMER_EXPIRE",
        ),
        "TECHNOLOGY": ("UNKNOWN", "NIMH", "LION", "LIPO", "LIFE", "NICD", "LIMN"),
    }.items()
    for value, name in enumerate(names)
)  # fmt: skip

_MARKERS = (
    "ARROW CUBE SPHERE CYLINDER LINE_STRIP LINE_LIST CUBE_LIST SPHERE_LIST POINTS TEXT_VIEW_FACING MESH_RESOURCE "
    "TRIANGLE_LIST"
)
_MARKER_CONSTANTS = "\n".join(
    [f"int32 {name}={value}" for value, name in enumerate(_MARKERS.split())]
    + ["int32 ADD=0", "int32 MODIFY=0", "int32 DELETE=2", "int32 DELETEALL=3"]
)

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "sensor_msgs/Imu": (
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "sensor_msgs/BatteryState": (
        f"{_BATTERY_CONSTANTS}\nstd_msgs/Header header\n"
        "float32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\nfloat32 capacity\n"
        "float32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\n"
        "uint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\nfloat32[] cell_temperature\n"
        "string location\nstring serial_number"
    ),
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        f"{_MARKER_CONSTANTS}\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n"
        "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
        "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "vpptwin_msgs/RateThrust": "std_msgs/Header header\nfloat64 thrust\nfloat64 rate",
    "vpptwin_msgs/RotorCommand": "std_msgs/Header header\nfloat64[2] blade_pitch\nfloat64[2] throttle",
    "vpptwin_msgs/RotorState": "std_msgs/Header header\nfloat64[2] speed\nfloat64[2] current",
}


def shorten_type(name: str) -> str:
    """Type name without its `msg` part: `sensor_msgs/msg/Imu` and `sensor_msgs/Imu` are one type."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else name


def compose_definition(name: str) -> str:
    """Definition of a message type with those of all messages it is made of, parted by `=`, as rosbag2 embeds it."""
    pending, ordered = [shorten_type(name)], list[str]()
    while pending:
        current = pending.pop(0)
        if current in ordered:
            continue
        ordered.append(current)
        bases = (line.split()[0].partition("[")[0] for line in DEFINITIONS[current].splitlines())
        pending += [base for base in bases if base in DEFINITIONS]
    sections = [DEFINITIONS[ordered[0]], *(f"MSG: {other}\n{DEFINITIONS[other]}" for other in ordered[1:])]
    return f"\n{'=' * 80}\n".join(sections) + "\n"
