#include "hal/stm32f7/devices/devices.h"

#include "common/words.h"
#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/fault.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/motor_pins.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "motors/dshot.h"
#include "motors/dshot_telemetry.h"
#include "nf_contract.h"

/* Frames are written to the pins' GPIO ports by DMA: at each of TIM1's updates a stream moves one word to its port's BSRR.
 * A bit is three words: all pulses begin; those of zeros end; the others end. So a pulse lasts a third or two thirds of a
 * bit, where DShot's nominal values are 37.5 and 75 %: decoders compare with half a bit. Only the middle words change.
 *
 * With the setting motor_telemetry the lines rest high, pulses are low, and each frame is answered on the same line: when
 * the last word is written an interrupt turns the pins into inputs, and the same streams, three times a bit of the answer,
 * store the port's levels. When the last one is stored they are decoded, between two runs of the control path. */
#define FRAME_BITS 16u
#define WORDS_A_BIT 3u
#define REST_WORDS 6u          /* behind the last bit: no frame may follow without a rest of two bits */
#define ANSWERED_REST_WORDS 2u /* an answer is a longer one, and nobody may drive the line meanwhile */
#define FRAME_WORDS (FRAME_BITS * WORDS_A_BIT + REST_WORDS)

/* An answer begins about 30 us after the frame's end (AM32 and Bluejay by their source; BLHeli_32 as users see it). The
 * samples begin when the rest above has passed. */
#define ANSWER_EARLIEST_US 8u
#define ANSWER_LATEST_US 38u
#define SAMPLES_OF_US(us, hz) (((us) * (hz) + 999999u) / 1000000u)
#define ANSWER_PAIRS(hz) ((SAMPLES_OF_US(ANSWER_LATEST_US, hz) + DSHOT_ANSWER_SAMPLES + 1u) / 2u)

#define GROUP 4u /* motors that one table serves, and whose frames are made side by side */
#define GROUPS (NF_MOTOR_COUNT_MAX / GROUP)

/* Speeds of a protocol. */
#define SPEED(bits_a_second)                                                             \
	{                                                                                \
		.word_ticks = CLOCK_TIM1_HZ / (WORDS_A_BIT * (bits_a_second)),           \
		.sample_ticks = CLOCK_TIM1_HZ / SAMPLE_HZ(bits_a_second),                \
		.pairs = ANSWER_PAIRS(SAMPLE_HZ(bits_a_second)),                         \
		.earliest = SAMPLES_OF_US(ANSWER_EARLIEST_US, SAMPLE_HZ(bits_a_second)), \
	}
#define SAMPLE_HZ(bits_a_second) (DSHOT_ANSWER_OVERSAMPLING * (bits_a_second) / 4u * 5u)
static const struct speed {
	uint32_t word_ticks;   /* of TIM1 a word of a frame */
	uint32_t sample_ticks; /* and a sample of an answer */
	uint32_t pairs;        /* of samples */
	uint32_t earliest;     /* sample at which an answer may begin */
} speeds[] = {
	[NF_MOTOR_PROTOCOL_DSHOT300] = SPEED(300000u),
	[NF_MOTOR_PROTOCOL_DSHOT600] = SPEED(600000u),
	[NF_MOTOR_PROTOCOL_DSHOT150] = SPEED(150000u),
};
#define PAIRS_MAX ANSWER_PAIRS(SAMPLE_HZ(600000u))

/* Of each word, as of BSRR, the halves: pins that are set, pins that are reset. */
static DMA_BUFFER_SLOW uint16_t motor_words[NF_BOARD_MOTOR_PORTS_MAX][FRAME_WORDS][2];
/* DMA writes these, yet not to DTCM, which is the policy's: each word that is read costs some cycles more. */
static DMA_BUFFER_SLOW uint32_t motor_samples[NF_BOARD_MOTOR_PORTS_MAX][PAIRS_MAX];

/* A port that motors are wired to. Set by motors_run. */
static struct motor_port {
	struct dma_stream stream;
	uint32_t port;  /* GPIOA.. */
	uint32_t pins;  /* of motors in use */
	uint32_t modes; /* the lower bit of each of their fields in GPIO_MODER */
	/* Pins of zeros, for each pattern of four motors' bits, the first motor's lowest. */
	uint16_t zeros[GROUPS][1u << GROUP];
} ports[NF_BOARD_MOTOR_PORTS_MAX];

/* Set by motors_run. */
static struct {
	uint32_t ports; /* with motors in use; 0 before */
	uint32_t last; /* port that DMA serves last */
	uint32_t motors;
	uint32_t words; /* of a frame */
	uint32_t requests; /* TIM_DIER: those of all ports */
	const struct speed *speed;
	bool telemetry;
	uint8_t places[NF_MOTOR_COUNT_MAX]; /* of each motor: its port's number in `ports`, times 16, and its pin's */
} setup;

/* SENDING is the writer's; it becomes LISTENING by the interrupt alone. */
static volatile enum phase {
	RESTING, /* a frame may be sent, or is one that nobody answers */
	SENDING, /* a frame that will be answered */
	LISTENING, /* the pins are inputs, and the streams store samples, or have: they are not decoded yet */
} phase;
static _Alignas(4) uint16_t answers[NF_MOTOR_COUNT_MAX]; /* the newest */
static int16_t learned[NF_BOARD_MOTOR_PORTS_MAX][DSHOT_PORT_LINES]; /* of how long their bits are */

/* Frame and answer have long ended by the fourth write from theirs on: they take 99 us with DShot600 and 282 us with
 * DShot150, and writes come each 125 us at 8 kHz. A stream that is enabled at so many in a row gets no requests any more,
 * and would never end by itself. */
#define STUCK_WRITES 4u
static uint32_t writes_dropped, restarts;

/* The half of a word that begins or ends pulses: a place in `motor_words`. */
static uint32_t motors_half(bool begins)
{
	return begins != setup.telemetry ? 0u : 1u;
}

static void motors_forget(void)
{
	for (uint32_t i = 0; i < NF_MOTOR_COUNT_MAX; ++i)
		answers[i] = NF_ESC_SILENT;
}

/* Sets up the next port, and the words of its frames that stay. A port without motors in use is left alone. */
static __attribute__((cold)) void motors_start_port(const struct board_motor_port *described)
{
	const uint32_t number = setup.ports;
	struct motor_port *const self = &ports[number];

	*self = (struct motor_port){ .stream = stream_of(described->dma),
				     .port = pin_of((uint8_t)(described->port << 4)).port };
	for (uint32_t motor = 0; motor < setup.motors; ++motor) {
		const struct pin pin = pin_of(board.motor_pins[motor]);

		if (pin.port != self->port)
			continue;
		setup.places[motor] = (uint8_t)(number * DSHOT_PORT_LINES + pin.number);
		self->pins |= 1u << pin.number;
		self->modes |= FIELD(3u << 2u * pin.number, GPIO_OUTPUT);
		for (uint32_t bits = 0; bits < 1u << GROUP; ++bits)
			if ((bits >> motor % GROUP & 1u) == 0u)
				self->zeros[motor / GROUP][bits] |= (uint16_t)(1u << pin.number);
	}
	if (self->pins == 0u)
		return;
	++setup.ports;
	setup.requests |= TIM_DIER_CC1DE << (described->channel - 1u);
	if (self->stream.at > ports[setup.last].stream.at)
		setup.last = number;
	for (uint32_t i = 0; i < FRAME_WORDS; ++i) {
		const bool begins = i < WORDS_A_BIT * FRAME_BITS && i % WORDS_A_BIT == 0u;

		motor_words[number][i][motors_half(begins)] = (uint16_t)self->pins;
		motor_words[number][i][motors_half(!begins)] = 0;
	}
}

/* The lines rest from here on. */
static __attribute__((cold, noinline)) void motors_start_timer(void)
{
	TIM_DIER(TIM1) = 0;
	TIM_PSC(TIM1) = 0;
	TIM_ARR(TIM1) = setup.speed->word_ticks - 1u;
	TIM_CR2(TIM1) = TIM_CR2_CCDS; /* the channels ask with the update, all of them at once */
	TIM_EGR(TIM1) = TIM_EGR_UG;
	TIM_CR1(TIM1) = TIM_CR1_CEN;
	for (uint32_t i = 0; i < setup.ports; ++i)
		GPIO_BSRR(ports[i].port) = ports[i].pins << 16u * motors_half(false);
}

/* Runs once: small rather than quick, unlike the frames. */
__attribute__((cold)) void motors_run(uint32_t protocol, bool telemetry, size_t count)
{
	HAL_ASSERT(protocol < sizeof speeds / sizeof speeds[0] && count <= board.motor_count &&
		   board.motor_count <= NF_MOTOR_COUNT_MAX && board.motor_port_count <= NF_BOARD_MOTOR_PORTS_MAX);
	setup.speed = &speeds[protocol];
	setup.telemetry = telemetry;
	setup.motors = (uint32_t)count;
	setup.words = FRAME_BITS * WORDS_A_BIT + (telemetry ? ANSWERED_REST_WORDS : REST_WORDS);
	setup.ports = setup.requests = setup.last = 0;
	motors_forget();
	for (uint32_t i = 0; i < board.motor_port_count; ++i)
		motors_start_port(&board.motor_ports[i]);
	motors_start_timer();
	motor_pins_connect(count, telemetry);
	if (telemetry) {
		SCB_SHPR3 = (SCB_SHPR3 & ~SCB_SHPR3_PRI_14) | FIELD(SCB_SHPR3_PRI_14, PRIORITY_ANSWERS << 4);
		interrupt_enable(ports[setup.last].stream.interrupt, PRIORITY_MOTORS);
	}
	barrier();
}

/* Does DMA still move a frame or samples? */
static bool motors_moving(void)
{
	for (uint32_t i = 0; i < setup.ports; ++i)
		if (dma_busy(ports[i].stream))
			return true;
	return false;
}

#define FRAME_CYCLES (CLOCK_CORE_HZ / 5000u) /* 200 us; the longest, DShot150, takes 120 */

__attribute__((cold)) void motors_finish(void)
{
	const uint32_t start = time_cycles();

	while (phase != LISTENING && motors_moving() && time_cycles() - start < FRAME_CYCLES)
		;
}

/* Ends streams that are stuck and sets the timer up anew, as at the start: the lines rest from here on. No frame is sent
 * yet. What an ESC has of the one that broke off has no 16 bits; it forgets them in the rest before the next write. A
 * stream that cannot be ended is tried again later. */
static __attribute__((cold, noinline)) void motors_restart(void)
{
	++restarts;
	phase = RESTING; /* the interrupt of a stream that is ended finds nothing to do */
	motors_start_timer();
	for (uint32_t i = 0; i < setup.ports; ++i)
		if (dma_busy(ports[i].stream))
			(void)dma_stop(ports[i].stream);
	motors_forget();
}

uint32_t motors_restarts(void *context)
{
	return restarts;
}

/* From the next update on TIM1 asks for a word or sample of each port, every `ticks`. */
static void motors_pace(uint32_t ticks)
{
	TIM_ARR(TIM1) = ticks - 1u;
	TIM_CNT(TIM1) = 0; /* no update falls between this and the next line: all ports begin at the same one */
	TIM_DIER(TIM1) = setup.requests;
}

/* The pins listen from here on. */
static void motors_listen(void)
{
	TIM_DIER(TIM1) = 0;
	for (uint32_t i = 0; i < setup.ports; ++i) {
		const struct motor_port *const self = &ports[i];

		GPIO_MODER(self->port) &= ~self->modes; /* inputs, with the pull-up that they have */
		dma_setup(self->stream, &GPIO_IDR(self->port), DMA_FROM_PERIPHERAL, DMA_HALF_WORD, DMA_VERY_HIGH,
			  i == setup.last ? DMA_SCR_TCIE : 0u);
		dma_start(self->stream, motor_samples[i], 2u * setup.speed->pairs);
	}
	motors_pace(setup.speed->sample_ticks);
	phase = LISTENING;
}

/* A frame's last word is written, or the last sample of its answers: of the streams that are asked at the same time the one
 * with the highest number comes last (RM0431 8.3.4, arbiter). If another one has not ended nobody listens, or reads, and the
 * writes find it stuck. */
void motors_moved_handler(void)
{
	dma_clear(ports[setup.last].stream);
	barrier(); /* cleared before the handler can return, or it would run twice */
	if (motors_moving())
		return;
	if (phase == SENDING)
		motors_listen();
	else if (phase == LISTENING)
		SCB_ICSR = SCB_ICSR_PENDSVSET;
}

/* Neither interrupts the control path nor is interrupted by it, which reads and writes between two runs of this. */
void motors_answers_handler(void)
{
	uint16_t lines[NF_BOARD_MOTOR_PORTS_MAX * DSHOT_PORT_LINES];

	if (phase != LISTENING)
		return; /* the streams have been ended meanwhile */
	barrier();
	for (uint32_t i = 0; i < setup.ports; ++i)
		dshot_telemetry_decode(motor_samples[i], setup.speed->pairs, setup.speed->earliest, ports[i].pins,
				       learned[i], lines + DSHOT_PORT_LINES * i);
	for (uint32_t i = 0; i < setup.motors; ++i)
		answers[i] = lines[setup.places[i]];
	phase = RESTING;
}

void motors_read(void *context, uint16_t words[NF_MOTOR_COUNT_MAX])
{
	words_copy(words, answers, sizeof answers);
}

/* A byte of each of four frames, motors 1, 3, 2 and 4 from the lowest on. */
#define EACH 0x01010101u
#define EVEN_BYTES 0x00FF00FFu
/* Times a bit of each byte: the four of them side by side above bit 24, the first motor's lowest. */
#define GATHER (1u << 24 | 1u << 18 | 1u << 9 | 1u << 3)

struct frames {
	uint32_t first, last; /* bytes: a frame's first eight bits, its last eight */
};

/* `values`: of four motors, two in a word. */
static inline struct frames motors_frames(const uint32_t values[GROUP / 2u], bool telemetry)
{
	const uint32_t low = dshot_frames(values[0], telemetry, setup.telemetry),
		       high = dshot_frames(values[1], telemetry, setup.telemetry);

	return (struct frames){
		.first = (low >> 8 & EVEN_BYTES) | (high & ~EVEN_BYTES),
		.last = (low & EVEN_BYTES) | (high & EVEN_BYTES) << 8,
	};
}

/* Pins of zeros for a bit of a byte of each of four frames. */
static inline uint16_t motors_zeros(const uint16_t zeros[1u << GROUP], uint32_t bytes, uint32_t bit)
{
	return zeros[(bytes >> bit & EACH) * GATHER >> 24];
}

/* The words that differ from frame to frame. `half`: the first one's that ends the pulses of zeros. `more`: besides those
 * that other motors of this port have there. */
static void motors_fill(uint16_t *half, const uint16_t zeros[1u << GROUP], struct frames frames, bool more)
{
	const uint32_t byte = 8u * 2u * WORDS_A_BIT;

	for (uint32_t bit = 8; bit-- > 0; half += 2u * WORDS_A_BIT) {
		uint32_t first = motors_zeros(zeros, frames.first, bit), last = motors_zeros(zeros, frames.last, bit);

		if (more) {
			first |= half[0];
			last |= half[byte];
		}
		half[0] = (uint16_t)first;
		half[byte] = (uint16_t)last;
	}
}

bool motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry)
{
	union {
		uint16_t each[NF_MOTOR_COUNT_MAX];
		uint32_t pairs[NF_MOTOR_COUNT_MAX / 2u];
	} values;
	struct frames frames[GROUPS];

	if (setup.ports == 0u)
		return false;
	if (phase == SENDING || motors_moving()) {
		if (++writes_dropped % STUCK_WRITES == 0)
			motors_restart();
		return false;
	}
	writes_dropped = 0;
	for (uint32_t group = 0; GROUP * group < setup.motors; ++group) {
		for (uint32_t motor = GROUP * group; motor < GROUP * (group + 1u); ++motor)
			values.each[motor] = motor < count ? dshot[motor] : NF_DSHOT_STOP;
		frames[group] = motors_frames(&values.pairs[GROUP / 2u * group], telemetry);
	}
	TIM_DIER(TIM1) = 0;
	for (uint32_t i = 0; i < setup.ports; ++i) {
		const struct motor_port *const self = &ports[i];
		bool more = false;

		for (uint32_t group = 0; GROUP * group < setup.motors; ++group) {
			const uint16_t *const zeros = self->zeros[group];

			if (zeros[0] == 0u)
				continue; /* none of them is wired to this port */
			motors_fill(&motor_words[i][1][motors_half(false)], zeros, frames[group], more);
			more = true;
		}
		if (setup.telemetry)
			GPIO_MODER(self->port) |= self->modes; /* outputs again: at rest, as the last word left them */
		dma_clear(self->stream); /* the end of the samples is no frame's */
		dma_setup(self->stream, &GPIO_BSRR(self->port), DMA_TO_PERIPHERAL, DMA_WORD, DMA_VERY_HIGH,
			  setup.telemetry && i == setup.last ? DMA_SCR_TCIE : 0u);
		dma_start(self->stream, motor_words[i], setup.words);
	}
	phase = setup.telemetry ? SENDING : RESTING;
	motors_pace(setup.speed->word_ticks);
	return true;
}
