from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BodyFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "topology", "depth_width_px", "depth_height_px", "tilt_rad", "height_m", "tracking_ids", "tracked", "clipped_edges", "joint_states", "positions_m", "depth_px", "orientations")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    TOPOLOGY_FIELD_NUMBER: _ClassVar[int]
    DEPTH_WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    DEPTH_HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    TILT_RAD_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    TRACKING_IDS_FIELD_NUMBER: _ClassVar[int]
    TRACKED_FIELD_NUMBER: _ClassVar[int]
    CLIPPED_EDGES_FIELD_NUMBER: _ClassVar[int]
    JOINT_STATES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    DEPTH_PX_FIELD_NUMBER: _ClassVar[int]
    ORIENTATIONS_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    topology: str
    depth_width_px: int
    depth_height_px: int
    tilt_rad: float
    height_m: float
    tracking_ids: bytes
    tracked: bytes
    clipped_edges: bytes
    joint_states: bytes
    positions_m: bytes
    depth_px: bytes
    orientations: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., topology: _Optional[str] = ..., depth_width_px: _Optional[int] = ..., depth_height_px: _Optional[int] = ..., tilt_rad: _Optional[float] = ..., height_m: _Optional[float] = ..., tracking_ids: _Optional[bytes] = ..., tracked: _Optional[bytes] = ..., clipped_edges: _Optional[bytes] = ..., joint_states: _Optional[bytes] = ..., positions_m: _Optional[bytes] = ..., depth_px: _Optional[bytes] = ..., orientations: _Optional[bytes] = ...) -> None: ...

class PotentialSkeleton(_message.Message):
    __slots__ = ("sensor", "tracking_id", "time_ns", "tilt_rad", "height_m", "T_world_sensor", "positions_m", "joint_states", "mirrored")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    TRACKING_ID_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    TILT_RAD_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_SENSOR_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    JOINT_STATES_FIELD_NUMBER: _ClassVar[int]
    MIRRORED_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    tracking_id: int
    time_ns: int
    tilt_rad: float
    height_m: float
    T_world_sensor: bytes
    positions_m: bytes
    joint_states: bytes
    mirrored: bool
    def __init__(self, sensor: _Optional[str] = ..., tracking_id: _Optional[int] = ..., time_ns: _Optional[int] = ..., tilt_rad: _Optional[float] = ..., height_m: _Optional[float] = ..., T_world_sensor: _Optional[bytes] = ..., positions_m: _Optional[bytes] = ..., joint_states: _Optional[bytes] = ..., mirrored: bool = ...) -> None: ...

class Person(_message.Message):
    __slots__ = ("id", "positions_m", "joint_states", "views", "joint_sd_m", "name")
    ID_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    JOINT_STATES_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    JOINT_SD_M_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    id: int
    positions_m: bytes
    joint_states: bytes
    views: _containers.RepeatedCompositeFieldContainer[PotentialSkeleton]
    joint_sd_m: bytes
    name: str
    def __init__(self, id: _Optional[int] = ..., positions_m: _Optional[bytes] = ..., joint_states: _Optional[bytes] = ..., views: _Optional[_Iterable[_Union[PotentialSkeleton, _Mapping]]] = ..., joint_sd_m: _Optional[bytes] = ..., name: _Optional[str] = ...) -> None: ...

class SensorPlace(_message.Message):
    __slots__ = ("sensor", "T_world_sensor", "position_sd_m", "rotation_sd_rad", "quality", "problem")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_SENSOR_FIELD_NUMBER: _ClassVar[int]
    POSITION_SD_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_SD_RAD_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    T_world_sensor: bytes
    position_sd_m: float
    rotation_sd_rad: float
    quality: str
    problem: str
    def __init__(self, sensor: _Optional[str] = ..., T_world_sensor: _Optional[bytes] = ..., position_sd_m: _Optional[float] = ..., rotation_sd_rad: _Optional[float] = ..., quality: _Optional[str] = ..., problem: _Optional[str] = ...) -> None: ...

class Scene(_message.Message):
    __slots__ = ("schema_version", "step", "at_ns", "sensor", "node_id", "sequence", "topology", "phase", "sensors_missing", "frames_remaining", "frames_wanted", "reason", "people", "sensors")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TOPOLOGY_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    SENSORS_MISSING_FIELD_NUMBER: _ClassVar[int]
    FRAMES_REMAINING_FIELD_NUMBER: _ClassVar[int]
    FRAMES_WANTED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    PEOPLE_FIELD_NUMBER: _ClassVar[int]
    SENSORS_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    step: int
    at_ns: int
    sensor: str
    node_id: int
    sequence: int
    topology: str
    phase: str
    sensors_missing: int
    frames_remaining: int
    frames_wanted: int
    reason: str
    people: _containers.RepeatedCompositeFieldContainer[Person]
    sensors: _containers.RepeatedCompositeFieldContainer[SensorPlace]
    def __init__(self, schema_version: _Optional[int] = ..., step: _Optional[int] = ..., at_ns: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., topology: _Optional[str] = ..., phase: _Optional[str] = ..., sensors_missing: _Optional[int] = ..., frames_remaining: _Optional[int] = ..., frames_wanted: _Optional[int] = ..., reason: _Optional[str] = ..., people: _Optional[_Iterable[_Union[Person, _Mapping]]] = ..., sensors: _Optional[_Iterable[_Union[SensorPlace, _Mapping]]] = ...) -> None: ...

class Truth(_message.Message):
    __slots__ = ("schema_version", "sensor", "sequence", "room_ns", "topology", "people", "positions_m", "T_world_sensor", "body_people", "mirrored")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ROOM_NS_FIELD_NUMBER: _ClassVar[int]
    TOPOLOGY_FIELD_NUMBER: _ClassVar[int]
    PEOPLE_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_SENSOR_FIELD_NUMBER: _ClassVar[int]
    BODY_PEOPLE_FIELD_NUMBER: _ClassVar[int]
    MIRRORED_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    sequence: int
    room_ns: int
    topology: str
    people: bytes
    positions_m: bytes
    T_world_sensor: bytes
    body_people: bytes
    mirrored: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., sequence: _Optional[int] = ..., room_ns: _Optional[int] = ..., topology: _Optional[str] = ..., people: _Optional[bytes] = ..., positions_m: _Optional[bytes] = ..., T_world_sensor: _Optional[bytes] = ..., body_people: _Optional[bytes] = ..., mirrored: _Optional[bytes] = ...) -> None: ...
