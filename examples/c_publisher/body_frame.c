/* Protobuf's wire format, as much as a BodyFrame needs.
 *
 * A message is its fields in a row. A field is a tag, (number << 3 | type) as a varint, and the value: a varint (0),
 * 8 bytes (1), 4 bytes (5), or a length as a varint and that many bytes (2). A field that is 0 or empty is left out.
 * Fixed-size numbers, also those inside the byte arrays, are little-endian on every machine.
 */
#include "body_frame.h"

#include <string.h>

enum { VARINT = 0, EIGHT_BYTES = 1, BYTES = 2, FOUR_BYTES = 5 };

size_t write_varint(uint64_t value, uint8_t *out)
{
    size_t n = 0;
    while (value > 0x7F) {
        out[n++] = (uint8_t)(value & 0x7F) | 0x80; /* seven bits, and: more follow */
        value >>= 7;
    }
    out[n++] = (uint8_t)value;
    return n;
}

static size_t little_endian(uint64_t value, size_t bytes, uint8_t *out)
{
    for (size_t i = 0; i < bytes; i++)
        out[i] = (uint8_t)(value >> 8 * i);
    return bytes;
}

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static size_t put_tag(unsigned number, unsigned type, uint8_t *out)
{
    return write_varint(number << 3 | type, out);
}

static size_t put_varint(unsigned number, uint64_t value, uint8_t *out)
{
    if (value == 0)
        return 0;
    size_t n = put_tag(number, VARINT, out);
    return n + write_varint(value, out + n);
}

static size_t put_fixed64(unsigned number, uint64_t value, uint8_t *out)
{
    if (value == 0)
        return 0;
    size_t n = put_tag(number, EIGHT_BYTES, out);
    return n + little_endian(value, 8, out + n);
}

static size_t put_float(unsigned number, float value, uint8_t *out)
{
    if (bits_of(value) == 0)
        return 0;
    size_t n = put_tag(number, FOUR_BYTES, out);
    return n + little_endian(bits_of(value), 4, out + n);
}

/* The tag and the length of a field of bytes; the caller writes the bytes after them. */
static size_t put_length(unsigned number, size_t length, uint8_t *out)
{
    if (length == 0)
        return 0;
    size_t n = put_tag(number, BYTES, out);
    return n + write_varint(length, out + n);
}

static size_t put_text(unsigned number, const char *text, uint8_t *out)
{
    size_t length = strlen(text), n = put_length(number, length, out);
    memcpy(out + n, text, length);
    return n + length;
}

size_t write_frame(const frame_t *f, uint8_t *out)
{
    size_t n = 0;
    n += put_varint(1, 1, out + n); /* schema_version */
    n += put_text(2, f->sensor, out + n);
    n += put_fixed64(3, f->node_id, out + n);
    n += put_varint(4, f->sequence, out + n);
    n += put_varint(5, (uint64_t)f->time_ns, out + n);
    n += put_varint(6, (uint64_t)f->sent_ns, out + n);
    n += put_text(7, "kinect_v2", out + n);
    n += put_varint(8, f->depth_width_px, out + n);
    n += put_varint(9, f->depth_height_px, out + n);
    n += put_float(10, f->tilt_rad, out + n);
    n += put_float(11, f->height_m, out + n);

    n += put_length(12, f->bodies * 8, out + n); /* tracking_ids */
    for (size_t b = 0; b < f->bodies; b++)
        n += little_endian(f->body[b].tracking_id, 8, out + n);
    n += put_length(13, f->bodies, out + n); /* tracked */
    for (size_t b = 0; b < f->bodies; b++)
        out[n++] = f->body[b].is_tracked;
    n += put_length(14, f->bodies, out + n); /* clipped_edges */
    for (size_t b = 0; b < f->bodies; b++)
        out[n++] = f->body[b].clipped_edges;
    n += put_length(15, f->bodies * JOINTS, out + n); /* joint_states */
    for (size_t b = 0; b < f->bodies; b++)
        for (size_t j = 0; j < JOINTS; j++)
            out[n++] = f->body[b].states[j];
    n += put_length(16, f->bodies * JOINTS * 3 * 4, out + n); /* positions_m */
    for (size_t b = 0; b < f->bodies; b++)
        for (size_t j = 0; j < JOINTS; j++)
            for (size_t axis = 0; axis < 3; axis++)
                n += little_endian(bits_of(f->body[b].positions_m[j][axis]), 4, out + n);
    return n;
}
