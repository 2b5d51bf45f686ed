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

class MarkerFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "width_px", "height_px", "names", "positions_px", "sd_px", "areas_px", "confidences")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_PX_FIELD_NUMBER: _ClassVar[int]
    SD_PX_FIELD_NUMBER: _ClassVar[int]
    AREAS_PX_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCES_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    width_px: int
    height_px: int
    names: _containers.RepeatedScalarFieldContainer[str]
    positions_px: bytes
    sd_px: bytes
    areas_px: bytes
    confidences: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., names: _Optional[_Iterable[str]] = ..., positions_px: _Optional[bytes] = ..., sd_px: _Optional[bytes] = ..., areas_px: _Optional[bytes] = ..., confidences: _Optional[bytes] = ...) -> None: ...

class PoseFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "space", "names", "positions_m", "orientations", "states")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    SPACE_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    ORIENTATIONS_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    space: str
    names: _containers.RepeatedScalarFieldContainer[str]
    positions_m: bytes
    orientations: bytes
    states: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., space: _Optional[str] = ..., names: _Optional[_Iterable[str]] = ..., positions_m: _Optional[bytes] = ..., orientations: _Optional[bytes] = ..., states: _Optional[bytes] = ...) -> None: ...

class DepthFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "width_px", "height_px", "unit_m", "lens", "depth")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    UNIT_M_FIELD_NUMBER: _ClassVar[int]
    LENS_FIELD_NUMBER: _ClassVar[int]
    DEPTH_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    width_px: int
    height_px: int
    unit_m: float
    lens: bytes
    depth: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., unit_m: _Optional[float] = ..., lens: _Optional[bytes] = ..., depth: _Optional[bytes] = ...) -> None: ...

class SeenArm(_message.Message):
    __slots__ = ("id", "left", "left_sure", "points_m", "point_states", "point_sd_m", "angles_rad", "T_camera_palm", "gesture", "gesture_sure", "grabbing")
    ID_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    LEFT_SURE_FIELD_NUMBER: _ClassVar[int]
    POINTS_M_FIELD_NUMBER: _ClassVar[int]
    POINT_STATES_FIELD_NUMBER: _ClassVar[int]
    POINT_SD_M_FIELD_NUMBER: _ClassVar[int]
    ANGLES_RAD_FIELD_NUMBER: _ClassVar[int]
    T_CAMERA_PALM_FIELD_NUMBER: _ClassVar[int]
    GESTURE_FIELD_NUMBER: _ClassVar[int]
    GESTURE_SURE_FIELD_NUMBER: _ClassVar[int]
    GRABBING_FIELD_NUMBER: _ClassVar[int]
    id: int
    left: bool
    left_sure: float
    points_m: bytes
    point_states: bytes
    point_sd_m: bytes
    angles_rad: bytes
    T_camera_palm: bytes
    gesture: str
    gesture_sure: float
    grabbing: bool
    def __init__(self, id: _Optional[int] = ..., left: bool = ..., left_sure: _Optional[float] = ..., points_m: _Optional[bytes] = ..., point_states: _Optional[bytes] = ..., point_sd_m: _Optional[bytes] = ..., angles_rad: _Optional[bytes] = ..., T_camera_palm: _Optional[bytes] = ..., gesture: _Optional[str] = ..., gesture_sure: _Optional[float] = ..., grabbing: bool = ...) -> None: ...

class ArmFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "width_px", "height_px", "lens", "method", "arms", "reason")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    LENS_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    ARMS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    width_px: int
    height_px: int
    lens: bytes
    method: str
    arms: _containers.RepeatedCompositeFieldContainer[SeenArm]
    reason: str
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., lens: _Optional[bytes] = ..., method: _Optional[str] = ..., arms: _Optional[_Iterable[_Union[SeenArm, _Mapping]]] = ..., reason: _Optional[str] = ...) -> None: ...

class ImageFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "width_px", "height_px", "format", "image", "empty_room")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    IMAGE_FIELD_NUMBER: _ClassVar[int]
    EMPTY_ROOM_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    width_px: int
    height_px: int
    format: str
    image: bytes
    empty_room: bool
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., format: _Optional[str] = ..., image: _Optional[bytes] = ..., empty_room: bool = ...) -> None: ...

class KeypointFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "topology", "width_px", "height_px", "ids", "positions_px", "confidences", "relative_m")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    TOPOLOGY_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    IDS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_PX_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCES_FIELD_NUMBER: _ClassVar[int]
    RELATIVE_M_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    topology: str
    width_px: int
    height_px: int
    ids: bytes
    positions_px: bytes
    confidences: bytes
    relative_m: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., topology: _Optional[str] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., ids: _Optional[bytes] = ..., positions_px: _Optional[bytes] = ..., confidences: _Optional[bytes] = ..., relative_m: _Optional[bytes] = ...) -> None: ...

class OtherFrame(_message.Message):
    __slots__ = ("schema_version", "sensor", "node_id", "sequence", "time_ns", "sent_ns", "kind", "content")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    sent_ns: int
    kind: str
    content: bytes
    def __init__(self, schema_version: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., sent_ns: _Optional[int] = ..., kind: _Optional[str] = ..., content: _Optional[bytes] = ...) -> None: ...

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
    __slots__ = ("id", "positions_m", "joint_states", "views", "joint_sd_m", "name", "condition")
    ID_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    JOINT_STATES_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    JOINT_SD_M_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    CONDITION_FIELD_NUMBER: _ClassVar[int]
    id: int
    positions_m: bytes
    joint_states: bytes
    views: _containers.RepeatedCompositeFieldContainer[PotentialSkeleton]
    joint_sd_m: bytes
    name: str
    condition: str
    def __init__(self, id: _Optional[int] = ..., positions_m: _Optional[bytes] = ..., joint_states: _Optional[bytes] = ..., views: _Optional[_Iterable[_Union[PotentialSkeleton, _Mapping]]] = ..., joint_sd_m: _Optional[bytes] = ..., name: _Optional[str] = ..., condition: _Optional[str] = ...) -> None: ...

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

class Hand(_message.Message):
    __slots__ = ("id", "left", "landmarks_m", "landmark_states", "landmark_sd_m", "angles_rad", "T_world_palm", "holds")
    ID_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    LANDMARKS_M_FIELD_NUMBER: _ClassVar[int]
    LANDMARK_STATES_FIELD_NUMBER: _ClassVar[int]
    LANDMARK_SD_M_FIELD_NUMBER: _ClassVar[int]
    ANGLES_RAD_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_PALM_FIELD_NUMBER: _ClassVar[int]
    HOLDS_FIELD_NUMBER: _ClassVar[int]
    id: int
    left: bool
    landmarks_m: bytes
    landmark_states: bytes
    landmark_sd_m: bytes
    angles_rad: bytes
    T_world_palm: bytes
    holds: str
    def __init__(self, id: _Optional[int] = ..., left: bool = ..., landmarks_m: _Optional[bytes] = ..., landmark_states: _Optional[bytes] = ..., landmark_sd_m: _Optional[bytes] = ..., angles_rad: _Optional[bytes] = ..., T_world_palm: _Optional[bytes] = ..., holds: _Optional[str] = ...) -> None: ...

class Points(_message.Message):
    __slots__ = ("names", "positions_m", "sd_m", "cameras")
    NAMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_M_FIELD_NUMBER: _ClassVar[int]
    SD_M_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    names: _containers.RepeatedScalarFieldContainer[str]
    positions_m: bytes
    sd_m: bytes
    cameras: bytes
    def __init__(self, names: _Optional[_Iterable[str]] = ..., positions_m: _Optional[bytes] = ..., sd_m: _Optional[bytes] = ..., cameras: _Optional[bytes] = ...) -> None: ...

class Object(_message.Message):
    __slots__ = ("name", "T_world_object", "outline_m", "state")
    NAME_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_OBJECT_FIELD_NUMBER: _ClassVar[int]
    OUTLINE_M_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    name: str
    T_world_object: bytes
    outline_m: bytes
    state: int
    def __init__(self, name: _Optional[str] = ..., T_world_object: _Optional[bytes] = ..., outline_m: _Optional[bytes] = ..., state: _Optional[int] = ...) -> None: ...

class Arm(_message.Message):
    __slots__ = ("id", "left", "points_m", "point_states", "point_sd_m", "angles_rad", "T_world_palm", "gesture", "gesture_sure", "grabbing", "person", "cameras")
    ID_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    POINTS_M_FIELD_NUMBER: _ClassVar[int]
    POINT_STATES_FIELD_NUMBER: _ClassVar[int]
    POINT_SD_M_FIELD_NUMBER: _ClassVar[int]
    ANGLES_RAD_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_PALM_FIELD_NUMBER: _ClassVar[int]
    GESTURE_FIELD_NUMBER: _ClassVar[int]
    GESTURE_SURE_FIELD_NUMBER: _ClassVar[int]
    GRABBING_FIELD_NUMBER: _ClassVar[int]
    PERSON_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    id: int
    left: bool
    points_m: bytes
    point_states: bytes
    point_sd_m: bytes
    angles_rad: bytes
    T_world_palm: bytes
    gesture: str
    gesture_sure: float
    grabbing: bool
    person: int
    cameras: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, id: _Optional[int] = ..., left: bool = ..., points_m: _Optional[bytes] = ..., point_states: _Optional[bytes] = ..., point_sd_m: _Optional[bytes] = ..., angles_rad: _Optional[bytes] = ..., T_world_palm: _Optional[bytes] = ..., gesture: _Optional[str] = ..., gesture_sure: _Optional[float] = ..., grabbing: bool = ..., person: _Optional[int] = ..., cameras: _Optional[_Iterable[str]] = ...) -> None: ...

class BodyView(_message.Message):
    __slots__ = ("camera", "overlap", "left_out", "outline_px", "contour_px")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    OVERLAP_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    OUTLINE_PX_FIELD_NUMBER: _ClassVar[int]
    CONTOUR_PX_FIELD_NUMBER: _ClassVar[int]
    camera: str
    overlap: float
    left_out: str
    outline_px: bytes
    contour_px: bytes
    def __init__(self, camera: _Optional[str] = ..., overlap: _Optional[float] = ..., left_out: _Optional[str] = ..., outline_px: _Optional[bytes] = ..., contour_px: _Optional[bytes] = ...) -> None: ...

class Body(_message.Message):
    __slots__ = ("id", "name", "build", "T_world_model", "angles_rad", "joint_names", "landmark_names", "landmarks_m", "landmark_states", "lost", "views", "person")
    ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BUILD_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_MODEL_FIELD_NUMBER: _ClassVar[int]
    ANGLES_RAD_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    LANDMARK_NAMES_FIELD_NUMBER: _ClassVar[int]
    LANDMARKS_M_FIELD_NUMBER: _ClassVar[int]
    LANDMARK_STATES_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    PERSON_FIELD_NUMBER: _ClassVar[int]
    id: int
    name: str
    build: str
    T_world_model: bytes
    angles_rad: bytes
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    landmark_names: _containers.RepeatedScalarFieldContainer[str]
    landmarks_m: bytes
    landmark_states: bytes
    lost: bool
    views: _containers.RepeatedCompositeFieldContainer[BodyView]
    person: int
    def __init__(self, id: _Optional[int] = ..., name: _Optional[str] = ..., build: _Optional[str] = ..., T_world_model: _Optional[bytes] = ..., angles_rad: _Optional[bytes] = ..., joint_names: _Optional[_Iterable[str]] = ..., landmark_names: _Optional[_Iterable[str]] = ..., landmarks_m: _Optional[bytes] = ..., landmark_states: _Optional[bytes] = ..., lost: bool = ..., views: _Optional[_Iterable[_Union[BodyView, _Mapping]]] = ..., person: _Optional[int] = ...) -> None: ...

class OtherPart(_message.Message):
    __slots__ = ("kind", "content")
    KIND_FIELD_NUMBER: _ClassVar[int]
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    kind: str
    content: bytes
    def __init__(self, kind: _Optional[str] = ..., content: _Optional[bytes] = ...) -> None: ...

class Scene(_message.Message):
    __slots__ = ("schema_version", "step", "at_ns", "sensor", "node_id", "sequence", "topology", "phase", "sensors_missing", "frames_remaining", "frames_wanted", "reason", "people", "sensors", "hands", "points", "objects", "arms", "bodies", "parts")
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
    HANDS_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    ARMS_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
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
    hands: _containers.RepeatedCompositeFieldContainer[Hand]
    points: Points
    objects: _containers.RepeatedCompositeFieldContainer[Object]
    arms: _containers.RepeatedCompositeFieldContainer[Arm]
    bodies: _containers.RepeatedCompositeFieldContainer[Body]
    parts: _containers.RepeatedCompositeFieldContainer[OtherPart]
    def __init__(self, schema_version: _Optional[int] = ..., step: _Optional[int] = ..., at_ns: _Optional[int] = ..., sensor: _Optional[str] = ..., node_id: _Optional[int] = ..., sequence: _Optional[int] = ..., topology: _Optional[str] = ..., phase: _Optional[str] = ..., sensors_missing: _Optional[int] = ..., frames_remaining: _Optional[int] = ..., frames_wanted: _Optional[int] = ..., reason: _Optional[str] = ..., people: _Optional[_Iterable[_Union[Person, _Mapping]]] = ..., sensors: _Optional[_Iterable[_Union[SensorPlace, _Mapping]]] = ..., hands: _Optional[_Iterable[_Union[Hand, _Mapping]]] = ..., points: _Optional[_Union[Points, _Mapping]] = ..., objects: _Optional[_Iterable[_Union[Object, _Mapping]]] = ..., arms: _Optional[_Iterable[_Union[Arm, _Mapping]]] = ..., bodies: _Optional[_Iterable[_Union[Body, _Mapping]]] = ..., parts: _Optional[_Iterable[_Union[OtherPart, _Mapping]]] = ...) -> None: ...

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
