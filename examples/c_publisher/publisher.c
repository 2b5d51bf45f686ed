/* A sensor program in C: publishes the skeleton of somebody who waves, through Mocapella's TCP bridge.
 *
 *   make && ./publisher --vector > frame.bin      the test vector tests/vectors/frame_skeleton.bin, byte for byte
 *   ./publisher SENSOR [PORT [FRAMES]]            30 frames a second to 127.0.0.1:PORT (7450), for ever or FRAMES long
 *
 * Start the bridge first: mocapella node bridge --listen 127.0.0.1:7450
 */
#define _POSIX_C_SOURCE 200809L
#include "body_frame.h"

#include <arpa/inet.h>
#include <errno.h>
#include <math.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define FRAME_NS 33333333 /* 30 Hz */

static int64_t monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void wait_until(int64_t due_ns)
{
    int64_t left = due_ns - monotonic_ns();
    while (left > 0) {
        struct timespec pause = {left / 1000000000, left % 1000000000};
        nanosleep(&pause, NULL);
        left = due_ns - monotonic_ns();
    }
}

static uint64_t random_id(void)
{
    uint64_t id = 0;
    FILE *source = fopen("/dev/urandom", "rb");
    if (source == NULL || fread(&id, sizeof id, 1, source) != 1)
        id = (uint64_t)monotonic_ns() ^ (uint64_t)getpid() << 32;
    if (source != NULL)
        fclose(source);
    return id == 0 ? 1 : id;
}

/* Where the joints of somebody are who stands 2.5 m before the sensor, in metres; x to the sensor's left, y up. */
static const float STANDING[JOINTS][3] = {
    {0, -.1f, 2.5f}, {0, .2f, 2.5f}, {0, .5f, 2.5f}, {0, .65f, 2.5f},                       /* base, mid, neck, head */
    {-.2f, .42f, 2.5f}, {-.24f, .15f, 2.5f}, {-.25f, -.1f, 2.5f}, {-.25f, -.18f, 2.5f},     /* left arm */
    {.2f, .42f, 2.5f}, {.24f, .15f, 2.5f}, {.25f, -.1f, 2.5f}, {.25f, -.18f, 2.5f},         /* right arm */
    {-.1f, -.1f, 2.5f}, {-.1f, -.5f, 2.5f}, {-.1f, -.9f, 2.5f}, {-.1f, -.95f, 2.4f},        /* left leg */
    {.1f, -.1f, 2.5f}, {.1f, -.5f, 2.5f}, {.1f, -.9f, 2.5f}, {.1f, -.95f, 2.4f},            /* right leg */
    {0, .45f, 2.5f}, {-.25f, -.25f, 2.5f}, {-.22f, -.17f, 2.5f}, {.25f, -.25f, 2.5f}, {.22f, -.17f, 2.5f},
};

/* In a Kinect program, this is where the SDK's Body[] is copied into the frame. */
static void somebody_waves(frame_t *frame, double seconds)
{
    static const int HAND[] = {10, 11, 23, 24}; /* WristRight, HandRight, HandTipRight, ThumbRight */
    body_t *body = &frame->body[0];
    frame->bodies = 1;
    body->tracking_id = 1;
    body->is_tracked = 1;
    memset(body->states, TRACKED, sizeof body->states);
    memcpy(body->positions_m, STANDING, sizeof STANDING);
    for (size_t i = 0; i < sizeof HAND / sizeof HAND[0]; i++) {
        body->positions_m[HAND[i]][0] += .15f * (float)sin(4 * seconds);
        body->positions_m[HAND[i]][1] += .6f;
    }
}

/* The frame of tests/vectors/frame_skeleton.json; its floats are exact, so every machine computes the same bits. */
static void test_vector(frame_t *frame)
{
    frame->sensor = "front";
    frame->depth_width_px = 512;
    frame->depth_height_px = 424;
    frame->node_id = 0x0123456789ABCDEF;
    frame->sequence = 2;
    frame->time_ns = 66666667;
    frame->sent_ns = 5000000123;
    frame->tilt_rad = -.125f;
    frame->height_m = 1.5f;
    frame->bodies = 2;
    for (int b = 0; b < 2; b++) {
        body_t *body = &frame->body[b];
        body->tracking_id = 72057594037927937u + (uint64_t)b;
        body->is_tracked = 1;
        body->clipped_edges = b == 0 ? 0 : 9; /* right and bottom */
        for (int j = 0; j < JOINTS; j++) {
            body->states[j] = j % 8 == 7 ? NOT_TRACKED : j % 8 == 3 ? INFERRED : TRACKED;
            if (body->states[j] == NOT_TRACKED)
                continue;
            body->positions_m[j][0] = (float)(j - 12) / 16 + (float)(2 * b - 1);
            body->positions_m[j][1] = (float)(12 - j) / 8;
            body->positions_m[j][2] = 2 + (float)j / 64;
        }
    }
}

static int connect_to(int port)
{
    struct sockaddr_in address;
    int one = 1, bridge = socket(AF_INET, SOCK_STREAM, 0);
    if (bridge < 0)
        return -1;
    memset(&address, 0, sizeof address);
    address.sin_family = AF_INET;
    address.sin_port = htons((uint16_t)port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(bridge, (struct sockaddr *)&address, sizeof address) != 0) {
        close(bridge);
        return -1;
    }
    setsockopt(bridge, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one); /* send every frame at once */
    return bridge;
}

static int send_all(int bridge, const uint8_t *data, size_t length)
{
    while (length > 0) {
        ssize_t sent = send(bridge, data, length, 0);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent < 0)
            return -1;
        data += sent;
        length -= (size_t)sent;
    }
    return 0;
}

/* The bridge closes the connection when a frame is wrong, and first says why in one line. */
static void print_answer(int bridge)
{
    char answer[500];
    ssize_t length = recv(bridge, answer, sizeof answer - 1, MSG_DONTWAIT);
    if (length > 0)
        fprintf(stderr, "the bridge says: %.*s", (int)length, answer);
}

static int publish(const char *sensor, int port, long frames)
{
    static frame_t frame;
    static uint8_t message[FRAME_BYTES], packet[FRAME_BYTES + 10];
    int bridge = connect_to(port);
    if (bridge < 0) {
        fprintf(stderr, "no bridge at 127.0.0.1:%d (%s); start: mocapella node bridge\n", port, strerror(errno));
        return 1;
    }
    frame.sensor = sensor;
    frame.depth_width_px = 512;
    frame.depth_height_px = 424;
    frame.node_id = random_id();
    int64_t begin = monotonic_ns();
    for (long i = 0; frames < 0 || i < frames; i++) {
        wait_until(begin + i * FRAME_NS);
        frame.sequence = (uint64_t)i;
        frame.time_ns = i * FRAME_NS;
        somebody_waves(&frame, 1e-9 * (double)frame.time_ns);
        frame.sent_ns = monotonic_ns();
        size_t length = write_frame(&frame, message);
        size_t prefix = write_varint(length, packet); /* the length first, then the message */
        memcpy(packet + prefix, message, length);
        if (send_all(bridge, packet, prefix + length) != 0) {
            fprintf(stderr, "the connection ended: %s\n", strerror(errno));
            print_answer(bridge);
            close(bridge);
            return 1;
        }
    }
    close(bridge);
    return 0;
}

int main(int argc, char **argv)
{
    static frame_t frame;
    static uint8_t message[FRAME_BYTES];
    signal(SIGPIPE, SIG_IGN); /* a closed connection is an error of send(), not the end */
    if (argc == 2 && strcmp(argv[1], "--vector") == 0) {
        test_vector(&frame);
        size_t length = write_frame(&frame, message);
        return fwrite(message, 1, length, stdout) == length ? 0 : 1;
    }
    if (argc < 2 || argc > 4 || argv[1][0] == '-' || strlen(argv[1]) > 64) {
        fprintf(stderr, "usage: %s --vector | SENSOR [PORT [FRAMES]]\n", argv[0]);
        return 2;
    }
    return publish(argv[1], argc > 2 ? atoi(argv[2]) : 7450, argc > 3 ? atol(argv[3]) : -1);
}
