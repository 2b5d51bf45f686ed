/* A BodyFrame (src/mocapella/schema/mocapella.proto) and how to write it, without a protobuf library.
 *
 * In C# or C++ let protoc generate a class from the .proto instead; the fields and their meaning are the same.
 */
#ifndef BODY_FRAME_H
#define BODY_FRAME_H

#include <stddef.h>
#include <stdint.h>

#define JOINTS 25     /* of a Kinect v2, in the order of the SDK's JointType */
#define MAX_BODIES 6  /* of a Kinect v2; the schema itself allows 1024 */
#define FRAME_BYTES 8192 /* more than MAX_BODIES bodies with positions need */

enum { NOT_TRACKED = 0, INFERRED = 1, TRACKED = 2 }; /* TrackingState */

typedef struct {
    uint64_t tracking_id;
    uint8_t is_tracked;             /* 0 or 1 */
    uint8_t clipped_edges;          /* FrameEdges */
    uint8_t states[JOINTS];         /* NOT_TRACKED, INFERRED or TRACKED */
    float positions_m[JOINTS][3];   /* camera space; 0 where NOT_TRACKED */
} body_t;

typedef struct {
    const char *sensor;             /* 1 to 64 of A-Z a-z 0-9 _ . -, first a letter or digit */
    uint64_t node_id;               /* a random number, new at each start of the program, not 0 */
    uint64_t sequence;              /* 0, 1, 2, ... */
    int64_t time_ns;                /* of capture, on the sensor's clock: RelativeTime.Ticks * 100 */
    int64_t sent_ns;                /* of sending, on this machine's monotonic clock; 0 = unknown */
    uint32_t depth_width_px, depth_height_px;
    float tilt_rad, height_m;
    size_t bodies;
    body_t body[MAX_BODIES];
} frame_t;

/* Writes the message into out (FRAME_BYTES long) and says how many bytes it has. */
size_t write_frame(const frame_t *frame, uint8_t *out);

/* Writes a number as a protobuf varint, at most 10 bytes, and says how many it took. */
size_t write_varint(uint64_t value, uint8_t *out);

#endif
