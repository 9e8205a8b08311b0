/* A whole firmware under any bytes on its MSP ports. Input: a byte that chooses the beginning, then steps. A step is a
 * byte, of which bits 0 to 2 say which of `steps` it is and bit 3 the port. */
#include "world.h"

#define SAMPLES_MAX 3000u /* in an input: all of them together are the most of its time */
#define ROOM 4096u

/* What became of an input so far. */
struct course {
	struct world *world;
	struct input *input;
	unsigned told; /* the step's first byte */
	unsigned samples; /* that passed */
};

static unsigned course_port(const struct course *course)
{
	return course->told >> 3 & 1u;
}

static void course_say(struct course *course, const uint8_t *bytes, size_t count, size_t capacity)
{
	uint8_t *reply;
	const size_t size = world_talk(course->world, course_port(course), bytes, count, capacity, &reply);

	(void)size;
	free(reply);
}

/* A length and as many bytes, as they are. Bit 4: there is hardly room for the reply. */
static void course_bytes(struct course *course)
{
	size_t count = input_byte(course->input);
	uint8_t *const bytes = input_bytes(course->input, &count);

	course_say(course, bytes, count, course->told & 0x10 ? count : ROOM);
	free(bytes);
}

/* A command of two bytes, a length and as many bytes of payload. Bit 4: v2; bit 5: the checksum is wrong; bit 6: the
 * frame ends early; bit 7: the payload is twice as long. */
static void course_request(struct course *course)
{
	const unsigned low = input_byte(course->input), command = low | input_byte(course->input) << 8;
	const unsigned version = course->told & 0x10 || command > 254 ? 2 : 1;
	size_t count = input_byte(course->input);
	uint8_t *const given = input_bytes(course->input, &count);
	uint8_t payload[512], frame[WORLD_FRAME_MAX];

	memcpy(payload, given, count);
	if (course->told & 0x80) {
		memcpy(payload + count, given, count);
		count *= 2;
	}
	size_t size = world_request(version, command, payload, count, frame);
	frame[size - 1] ^= course->told & 0x20 ? 0x55 : 0;
	if (course->told & 0x40)
		size = size * 3 / 4;
	uint8_t *const exact = malloc(size);
	if (!exact)
		abort();
	memcpy(exact, frame, size);
	course_say(course, exact, size, ROOM);
	free(exact);
	free(given);
}

/* Samples pass: a byte of them, times 8 with bit 4. */
static void course_time(struct course *course)
{
	const unsigned wanted = input_byte(course->input) * (course->told & 0x10 ? 8u : 1u);
	const unsigned left = SAMPLES_MAX - course->samples, samples = wanted < left ? wanted : left;

	world_pass(course->world, samples);
	course->samples += samples;
}

/* Bit 4: the arm switch, bit 5: the throttle is up, bit 6: no more frames. */
static void course_pilot(struct course *course)
{
	struct world *world = course->world;

	world->channels_us[NF_CHANNEL_AUX1] = course->told & 0x10 ? NF_CHANNEL_MAX_US : NF_CHANNEL_MIN_US;
	world->channels_us[NF_CHANNEL_THROTTLE] = course->told & 0x20 ? NF_CHANNEL_MID_US : NF_CHANNEL_MIN_US;
	world->silent = course->told & 0x40;
}

/* The peer goes; with bit 4 it only pauses. */
static void course_hang_up(struct course *course)
{
	if (course->told & 0x10)
		world_pause(course->world, course_port(course));
	else
		world_hang_up(course->world, course_port(course));
}

/* Flash refuses from an operation on. */
static void course_flash(struct course *course)
{
	const unsigned at = input_byte(course->input);

	flash_model_cut(&course->world->board.flash, at, FLASH_CUT_BEFORE, 1);
}

/* The aircraft turns. */
static void course_shake(struct course *course)
{
	course->world->shaken = course->told & 0x10 ? 3.0 : 0.0;
}

/* The peer on the port sends nothing, and what came from the firmware by itself is read. */
static void course_listen(struct course *course)
{
	course_say(course, NULL, 0, ROOM);
}

static void (*const steps[8])(struct course *course) = {
	course_bytes,   course_request, course_time,  course_pilot,
	course_hang_up, course_flash,   course_shake, course_listen,
};

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input input = { data, size };
	struct course course = { .world = world_begin((enum beginning)(input_byte(&input) % BEGINNING_COUNT)),
				 .input = &input };

	while (input.left > 0) {
		course.told = input_byte(&input);
		steps[course.told & 7u](&course);
	}
	world_end(course.world);
	return 0;
}
