/* A stand-in for the libraries of an Azure Kinect: the parts of the C interfaces of libk4a and, with -DK4ABT, of
 * libk4abt that Mocapella calls, with bodies that move. Layouts are those of the vendor's headers.
 *
 * K4A_LOG      file that gets a line for each call that opens, starts, stops, closes or releases something
 * K4A_FAIL     name of a function that fails; with ":3", from its third call on; with ":3:2", so often
 * K4A_LATE     the same, of a function that reports a timeout, or of k4abt_tracker_create that never returns
 * K4A_DEVICES  number of cameras (1)
 * K4A_BODIES   number of bodies (2)
 * K4A_USEC     time of the first image (33333), and with K4A_STEP from one to the next (33333) [us]
 * K4A_LENS     type of the lenses (4)
 * K4A_JUMP     "5:-100000": from image 5 on the device's clock shows so much more [us]
 */
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { OK, FAILED, TIMEOUT }; /* of a buffer, the last is "too small" */

typedef struct { int color_format, color_resolution, depth_mode, camera_fps; bool synchronized; int32_t depth_delay;
                 int sync_mode; uint32_t subordinate_delay; bool no_led; } camera_t;
typedef struct { float rotation[9], translation[3]; } extrinsics_t;
typedef struct { extrinsics_t extrinsics; int type; unsigned count; float parameters[15]; int width, height;
                 float metric_radius; } lens_t;
typedef struct { lens_t depth, color; extrinsics_t extrinsics[4][4]; int depth_mode, color_resolution; } calibration_t;
_Static_assert(sizeof(calibration_t) == 1032, "k4a_calibration_t");
typedef struct { uint64_t number, usec; } capture_t;
typedef struct { int width, height, stride; uint64_t number, usec; uint8_t *pixels; } image_t;

static long number_of(const char *name, long otherwise) {
    const char *text = getenv(name);
    return text ? atol(text) : otherwise;
}

static void say(const char *what, long number) {
    const char *path = getenv("K4A_LOG");
    FILE *log = path ? fopen(path, "a") : NULL;
    if (!log) return;
    fprintf(log, "%s %ld\n", what, number);
    fclose(log);
}

typedef struct { int calls, session; } site_t;
static int session; /* of the camera or tracker that is open */

/* Whether a function is the one that a variable names, and this is a call of the session from which on it holds. */
static bool named(const char *variable, const char *function, site_t *site) {
    const char *text = getenv(variable);
    size_t length = strlen(function);
    if (!text || strncmp(text, function, length) || (text[length] && text[length] != ':')) return false;
    if (site->session != session) *site = (site_t){0, session};
    ++site->calls;
    if (!text[length]) return true;
    int from = atoi(text + length + 1);
    const char *often = strchr(text + length + 1, ':');
    return site->calls >= from && (!often || site->calls < from + atoi(often + 1));
}

#define RESULT(function)                                                                                               \
    do {                                                                                                               \
        static site_t fails, late;                                                                                     \
        if (named("K4A_FAIL", function, &fails)) return FAILED;                                                        \
        if (named("K4A_LATE", function, &late)) return TIMEOUT;                                                        \
    } while (0)

#ifndef K4ABT

static uint64_t images;
static int mode; /* of the depth camera */

/* cx cy fx fy k1 to k6 codx cody p2 p1 radius; the magnitudes are those of a device. */
static const float DEPTH_LENS[15] = {332.06f, 325.88f, 503.93f, 503.98f, 3.130577f, 2.324939f, 0.130416f, 3.458652f,
                                     3.350115f, 0.662942f, 0, 0, -0.00005f, 0.00008f, 1.74f};
static const float COLOUR_LENS[15] = {635.2f, 369.8f, 602.7f, 602.3f, 0.722746f, -2.88559f, 1.632723f, 0.602199f,
                                      -2.719626f, 1.565053f, 0, 0, -0.00014f, 0.00078f, 1.7f};

static void put_lens(lens_t *lens, const float *parameters, int width, int height, float scale) {
    lens->type = (int)number_of("K4A_LENS", 4);
    lens->count = 14;
    memcpy(lens->parameters, parameters, sizeof lens->parameters);
    for (int k = 0; k < 4; ++k) lens->parameters[k] *= scale;
    lens->width = width;
    lens->height = height;
}

uint32_t k4a_device_get_installed_count(void) { return (uint32_t)number_of("K4A_DEVICES", 1); }

int k4a_device_open(uint32_t index, void **device) {
    RESULT("k4a_device_open");
    uint32_t *made = malloc(sizeof *made);
    *made = index;
    *device = made;
    images = 0;
    ++session;
    say("open", index);
    return OK;
}

int k4a_device_get_serialnum(void *device, char *text, size_t *size) {
    RESULT("k4a_device_get_serialnum");
    *size = 1 + (size_t)snprintf(text, *size, "%012u", 1000 + *(uint32_t *)device);
    return OK;
}

int k4a_device_start_cameras(void *device, const camera_t *camera) {
    RESULT("k4a_device_start_cameras");
    if (camera->sync_mode || camera->no_led || camera->depth_delay) return FAILED;
    bool coloured = camera->color_resolution == 1 && camera->color_format == 3 && camera->synchronized;
    if (!coloured && (camera->color_resolution || camera->color_format || camera->synchronized)) return FAILED;
    if (coloured) say("colour", camera->color_resolution);
    mode = camera->depth_mode;
    say("start", 10 * camera->depth_mode + camera->camera_fps);
    (void)device;
    return OK;
}

int k4a_device_get_calibration(void *device, int depth_mode, int color_resolution, calibration_t *calibration) {
    RESULT("k4a_device_get_calibration");
    memset(calibration, 0, sizeof *calibration);
    calibration->depth_mode = depth_mode;
    calibration->color_resolution = 7 + color_resolution;
    put_lens(&calibration->depth, DEPTH_LENS, depth_mode == 1 ? 320 : 640, depth_mode == 1 ? 288 : 576,
             depth_mode == 1 ? 0.5f : 1.0f);
    if (color_resolution) put_lens(&calibration->color, COLOUR_LENS, 1280, 720, 1.0f);
    extrinsics_t *motion = &calibration->extrinsics[0][1]; /* from depth to colour */
    motion->rotation[1] = -1, motion->rotation[3] = motion->rotation[8] = 1;
    motion->translation[0] = -32, motion->translation[1] = -2, motion->translation[2] = 4;
    (void)device;
    return OK;
}

int k4a_device_get_capture(void *device, void **capture, int32_t timeout_ms) {
    usleep(timeout_ms < 5 ? (useconds_t)timeout_ms * 1000 : 5000);
    RESULT("k4a_device_get_capture");
    capture_t *made = malloc(sizeof *made);
    const char *jump = getenv("K4A_JUMP"), *by = jump ? strchr(jump, ':') : NULL;
    made->number = images++;
    made->usec = (uint64_t)number_of("K4A_USEC", 33333) + made->number * (uint64_t)number_of("K4A_STEP", 33333);
    if (by && made->number >= (uint64_t)atol(jump)) made->usec += (uint64_t)atol(by + 1);
    *capture = made;
    say("capture", (long)made->number);
    (void)device;
    return OK;
}

void k4a_capture_release(void *capture) {
    say("release", (long)((capture_t *)capture)->number);
    free(capture);
}

static void *image(const capture_t *of, int width, int height, int bytes, int padding) {
    image_t *made = malloc(sizeof *made);
    *made = (image_t){width, height, width * bytes + padding, of->number, of->usec, NULL};
    made->pixels = calloc((size_t)height, (size_t)made->stride);
    say("image", (long)of->number);
    return made;
}

/* The pixels (x, y) of image n: depth 701 + n + x + y, and colour blue 0, green 7, red 1 + n; padding is at row ends. */
void *k4a_capture_get_depth_image(void *capture) {
    static site_t fails;
    if (named("K4A_FAIL", "k4a_capture_get_depth_image", &fails)) return NULL;
    image_t *made = image(capture, mode == 1 ? 320 : 640, mode == 1 ? 288 : 576, 2, 6);
    for (int y = 0; y < made->height; ++y)
        for (int x = 0; x < made->width; ++x)
            ((uint16_t *)(made->pixels + y * made->stride))[x] = (uint16_t)(701 + made->number + (uint64_t)(x + y));
    return made;
}

void *k4a_capture_get_color_image(void *capture) {
    static site_t fails;
    if (named("K4A_FAIL", "k4a_capture_get_color_image", &fails)) return NULL;
    image_t *made = image(capture, 1280, 720, 4, 12);
    for (int y = 0; y < made->height; ++y)
        for (int x = 0; x < made->width; ++x) {
            uint8_t *pixel = made->pixels + y * made->stride + 4 * x;
            pixel[1] = 7, pixel[2] = (uint8_t)(1 + made->number), pixel[3] = 255;
        }
    return made;
}

uint8_t *k4a_image_get_buffer(void *image) { return ((image_t *)image)->pixels; }
int k4a_image_get_width_pixels(void *image) { return ((image_t *)image)->width; }
int k4a_image_get_height_pixels(void *image) { return ((image_t *)image)->height; }
int k4a_image_get_stride_bytes(void *image) { return ((image_t *)image)->stride; }
uint64_t k4a_image_get_device_timestamp_usec(void *image) { return ((image_t *)image)->usec; }

void k4a_image_release(void *image) {
    say("image-release", (long)((image_t *)image)->number);
    free(((image_t *)image)->pixels);
    free(image);
}

void k4a_device_stop_cameras(void *device) { say("stop", *(uint32_t *)device); }

void k4a_device_close(void *device) {
    say("close", *(uint32_t *)device);
    free(device);
}

#else

typedef struct { int orientation, processing; int32_t gpu; const char *model; } configuration_t;
typedef struct { float position[3], orientation[4]; int confidence; } joint_t;
typedef struct { joint_t joints[32]; } skeleton_t;
typedef struct { pthread_mutex_t lock; pthread_cond_t changed; capture_t queue[3]; int waiting; bool over; } tracker_t;

/* The tracker calls the camera's library, and must find the one that is loaded already. */
extern uint32_t k4a_device_get_installed_count(void) __attribute__((weak));

int k4abt_tracker_create(const calibration_t *calibration, configuration_t configuration, void **tracker) {
    static site_t fails, late;
    if (named("K4A_LATE", "k4abt_tracker_create", &late)) for (;;) sleep(600);
    if (named("K4A_FAIL", "k4abt_tracker_create", &fails)) return FAILED;
    if (!k4a_device_get_installed_count || calibration->depth_mode != 2 || calibration->color_resolution != 7) return FAILED;
    tracker_t *made = calloc(1, sizeof *made);
    pthread_mutex_init(&made->lock, NULL);
    pthread_cond_init(&made->changed, NULL);
    *tracker = made;
    ++session;
    say("create", 100 * configuration.orientation + 10 * configuration.processing + configuration.gpu);
    if (configuration.model) say(configuration.model, 0);
    return OK;
}

int k4abt_tracker_enqueue_capture(void *tracker, const capture_t *capture, int32_t timeout_ms) {
    RESULT("k4abt_tracker_enqueue_capture");
    tracker_t *to = tracker;
    (void)timeout_ms; /* 0: it is not waited for */
    pthread_mutex_lock(&to->lock);
    int result = to->over ? FAILED : to->waiting == 3 ? TIMEOUT : OK;
    if (result == OK) to->queue[to->waiting++] = *capture;
    pthread_cond_signal(&to->changed);
    pthread_mutex_unlock(&to->lock);
    return result;
}

int k4abt_tracker_pop_result(void *tracker, void **frame, int32_t timeout_ms) {
    RESULT("k4abt_tracker_pop_result");
    tracker_t *from = tracker;
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_nsec += (long)timeout_ms * 1000000;
    until.tv_sec += until.tv_nsec / 1000000000;
    until.tv_nsec %= 1000000000;
    pthread_mutex_lock(&from->lock);
    int waited = 0;
    while (!from->waiting && !from->over && !waited)
        waited = pthread_cond_timedwait(&from->changed, &from->lock, &until);
    int result = from->waiting ? OK : from->over ? FAILED : TIMEOUT;
    if (result == OK) {
        capture_t *made = malloc(sizeof *made);
        *made = from->queue[0];
        memmove(from->queue, from->queue + 1, sizeof(capture_t) * (size_t)--from->waiting);
        *frame = made;
        say("frame", (long)made->number);
    }
    pthread_mutex_unlock(&from->lock);
    return result;
}

void k4abt_tracker_shutdown(void *tracker) {
    tracker_t *one = tracker;
    pthread_mutex_lock(&one->lock);
    one->over = true;
    pthread_cond_broadcast(&one->changed);
    pthread_mutex_unlock(&one->lock);
    say("shutdown", 0);
}

void k4abt_tracker_destroy(void *tracker) {
    say("destroy", 0);
    free(tracker);
}

uint32_t k4abt_frame_get_num_bodies(void *frame) {
    (void)frame;
    return (uint32_t)number_of("K4A_BODIES", 2);
}

/* tests/support/k4a_stand_in.py computes the same. */
int k4abt_frame_get_body_skeleton(void *frame, uint32_t index, skeleton_t *skeleton) {
    RESULT("k4abt_frame_get_body_skeleton");
    float number = (float)((capture_t *)frame)->number;
    for (int k = 0; k < 32; ++k) {
        joint_t *joint = &skeleton->joints[k];
        joint->position[0] = -300.25f + 600.5f * (float)index + 3.125f * number;
        joint->position[1] = 40.5f * (float)k - 800.0f;
        joint->position[2] = 2000.0f + 1.75f * number + (float)k;
        joint->orientation[0] = 1.0f;
        joint->confidence = (k + (int)index) % 4;
        if (k == 29) joint->confidence = -1;
        if (k == 30) joint->position[1] = NAN;
        if (k == 31) joint->confidence = 9;
    }
    return OK;
}

uint32_t k4abt_frame_get_body_id(void *frame, uint32_t index) {
    static site_t fails;
    (void)frame;
    return named("K4A_FAIL", "k4abt_frame_get_body_id", &fails) ? 0xFFFFFFFF : index + 7;
}

uint64_t k4abt_frame_get_device_timestamp_usec(void *frame) { return ((capture_t *)frame)->usec; }

void k4abt_frame_release(void *frame) {
    say("frame-release", (long)((capture_t *)frame)->number);
    free(frame);
}

#endif
