#include "command_line/command_line.h"

#include "command_line/command.h"
#include "common/limit.h"

#define BACKSPACE 0x08
#define DELETE 0x7F
#define DROP_LINE 0x03 /* Ctrl-C */
#define COMMENT '#'
#define TYPED_SILENCE_S 300u
#define FRAMED_SILENCE_S 2u /* nobody types a frame */
#define PROMPT "# "
_Static_assert(COMMAND_LINE_BYTES <= UINT8_MAX, "the length of a line");

void command_line_init(struct command_line *cl, const struct services *services)
{
	*cl = (struct command_line){ .services = services };
}

bool command_line_open(const struct command_line *cl)
{
	return cl->mode != COMMAND_LINE_CLOSED;
}

bool command_line_busy(const struct command_line *cl)
{
	return cl->running || cl->frame_ended;
}

bool command_line_at_start(const struct command_line *cl)
{
	return !command_line_busy(cl) && cl->length == 0 && cl->fault == COMMAND_LINE_GOOD;
}

/* --- What is run instead of a command --------------------------------------------------------------------------- */
/* The Betaflight app shows the text after the first line end, and considers the session open once it contains "CLI". */
static bool line_greet(const struct task_line *t)
{
	printer_line(t->out, "\r\n" COMMAND_VERSION " CLI: 'help' lists the commands, 'exit' restarts without saving");
	return false;
}

static bool line_nothing(const struct task_line *t)
{
	return false;
}

static bool line_unknown(const struct task_line *t)
{
	command_error(t);
	printer_line(t->out, "%.*s: unknown command, expected one that 'help' lists" COMMAND_FOREIGN, 40, t->cl->line);
	return false;
}

static bool line_spoilt(const struct task_line *t)
{
	static const char *const words[] = {
		[COMMAND_LINE_TOO_LONG] = "line too long, expected at most 96 characters: nothing of it was done",
		[COMMAND_LINE_NO_TEXT] = "line with a byte that is no text: nothing of it was done; send it again",
		[COMMAND_LINE_UNENDED] = "line without its end in a frame: nothing of it was done",
		[COMMAND_LINE_LOST] = "bytes were lost: nothing of the line was done; send it again, more slowly",
	};
	_Static_assert(COMMAND_LINE_BYTES == 96, "as the words say");

	command_error(t);
	printer_line(t->out, "%s", words[t->cl->fault]);
	t->cl->fault = COMMAND_LINE_GOOD;
	return false;
}

static const struct command greeting = { .run = line_greet };
static const struct command nothing = { .run = line_nothing };
static const struct command unknown = { .run = line_unknown };
static const struct command spoilt = { .run = line_spoilt };

/* --- Sessions --------------------------------------------------------------------------------------------------- */
static void command_line_run(struct command_line *cl, const struct command *command)
{
	cl->running = command;
	cl->row = 0;
	cl->found = false;
}

bool command_line_begin(struct command_line *cl, uint8_t byte)
{
	if (byte != COMMAND_LINE_OPENS && byte != COMMAND_LINE_FRAME)
		return false;
	if (cl->services->session(cl->services->context, true) != NF_REFUSAL_NONE)
		return false;
	command_line_clear(cl);
	cl->heard = command_samples(cl);
	cl->after_cr = false;
	cl->failed = false;
	cl->mode = COMMAND_LINE_FRAMED;
	if (byte == COMMAND_LINE_FRAME)
		return true;
	cl->mode = COMMAND_LINE_TYPED;
	command_line_run(cl, &greeting);
	return true;
}

void command_line_spoil(struct command_line *cl)
{
	if (cl->mode != COMMAND_LINE_CLOSED && cl->fault == COMMAND_LINE_GOOD)
		cl->fault = COMMAND_LINE_NO_TEXT;
}

void command_line_lost(struct command_line *cl)
{
	if (cl->mode == COMMAND_LINE_CLOSED)
		return;
	cl->fault = COMMAND_LINE_LOST;
	cl->failed = true;
}

/* A frame's peer is gone after a moment, a typist after a while. */
static bool command_line_forgotten(const struct command_line *cl, const struct firmware_status *status)
{
	const uint32_t seconds = cl->mode == COMMAND_LINE_TYPED ? TYPED_SILENCE_S : FRAMED_SILENCE_S;

	return command_samples(cl) - cl->heard > seconds * status->gyro_rate_hz;
}

/* --- Lines ------------------------------------------------------------------------------------------------------ */
/* Returns the command of a whole line. A comment may contain any byte, but a line with lost bytes is an error. */
static const struct command *command_line_meant(struct command_line *cl)
{
	const char *arguments;

	if (cl->fault == COMMAND_LINE_LOST || (cl->fault != COMMAND_LINE_GOOD && cl->line[0] != COMMENT))
		return &spoilt;
	cl->fault = COMMAND_LINE_GOOD;
	while (cl->length > 0 && cl->line[cl->length - 1] == ' ')
		cl->line[--cl->length] = '\0';
	if (cl->length == 0 || cl->line[0] == COMMENT)
		return &nothing;
	const struct command *const command = command_find(cl->line, &arguments);
	return command ? command : &unknown;
}

static void command_line_add(struct command_line *cl, uint8_t byte)
{
	if (byte < ' ' || byte > '~') {
		command_line_spoil(cl);
	} else if (cl->length < COMMAND_LINE_BYTES) {
		cl->line[cl->length++] = (char)byte;
		cl->line[cl->length] = '\0';
	} else if (cl->fault == COMMAND_LINE_GOOD) {
		cl->fault = COMMAND_LINE_TOO_LONG;
	}
}

static void command_line_take_framed(struct command_line *cl, uint8_t byte)
{
	if (byte == '\n' || byte == '\r') {
		if (!command_line_at_start(cl))
			command_line_run(cl, command_line_meant(cl));
	} else if (byte == COMMAND_LINE_FRAME_END) {
		if (cl->length > 0 && cl->fault == COMMAND_LINE_GOOD)
			cl->fault = COMMAND_LINE_UNENDED;
		if (cl->fault != COMMAND_LINE_GOOD)
			command_line_run(cl, &spoilt);
		cl->frame_ended = true;
	} else {
		command_line_add(cl, byte);
	}
}

static void command_line_take_typed(struct command_line *cl, uint8_t byte, struct printer *out)
{
	if (byte == '\r' || byte == '\n') {
		printer_end(out);
		command_line_run(cl, command_line_meant(cl));
	} else if (byte == DROP_LINE) {
		command_line_clear(cl);
		printer_say(out, "\r\n" PROMPT);
	} else if ((byte == BACKSPACE || byte == DELETE) && cl->fault == COMMAND_LINE_GOOD) {
		if (cl->length == 0)
			return;
		cl->line[--cl->length] = '\0';
		printer_say(out, "\b \b");
	} else if (byte != '\t') {
		command_line_add(cl, byte);
		if (byte >= ' ' && byte <= '~')
			printer_say(out, "%c", byte);
	}
}

size_t command_line_take(struct command_line *cl, uint8_t byte, uint8_t *out, size_t capacity)
{
	if (capacity < COMMAND_LINE_ROOM || command_line_busy(cl))
		return 0;
	struct printer printer = printer_init((char *)out, capacity);
	const bool belongs = cl->after_cr && byte == '\n';

	cl->heard = command_samples(cl);
	cl->after_cr = byte == '\r';
	if (belongs)
		return 0;
	command_line_stop(cl);
	if (cl->mode == COMMAND_LINE_FRAMED)
		command_line_take_framed(cl, byte);
	else if (cl->mode == COMMAND_LINE_TYPED)
		command_line_take_typed(cl, byte, &printer);
	return (size_t)(printer.at - (char *)out);
}

/* --- Output ----------------------------------------------------------------------------------------------------- */
/* Ends the running command. */
static void command_line_done(struct command_line *cl, struct printer *out)
{
	cl->running = NULL;
	cl->length = 0; /* a fault since its end is the next line's */
	cl->line[0] = '\0';
	if (cl->mode == COMMAND_LINE_TYPED)
		printer_say(out, PROMPT);
}

/* The running command's next words. */
static void command_line_step(struct command_line *cl, const struct firmware_status *status, struct printer *out)
{
	const char *arguments = cl->line;

	(void)command_find(cl->line, &arguments);
	const struct task_line t = {
		.cl = cl,
		.services = cl->services,
		.status = status,
		.arguments = arguments,
		.row = cl->row,
		.out = out,
	};
	++cl->row;
	if (!cl->running->run(&t))
		command_line_done(cl, out);
}

static void command_line_watch_motor(struct command_line *cl, const struct firmware_status *status, struct printer *out)
{
	const char *const words = command_turn_motor(cl, status);

	if (words)
		printer_say(out, "%s\r\n" PROMPT "%s", words, cl->line);
}

size_t command_line_continue(struct command_line *cl, const struct firmware_status *status, uint8_t *out,
			     size_t capacity)
{
	size_t written = 0;

	if (capacity < COMMAND_LINE_ROOM || cl->mode == COMMAND_LINE_CLOSED)
		return 0;
	if (command_line_forgotten(cl, status)) {
		command_line_leave(cl);
		return 0;
	}
	if (!command_line_busy(cl)) {
		struct printer printer = printer_init((char *)out, capacity);
		command_line_watch_motor(cl, status, &printer);
		return (size_t)(printer.at - (char *)out);
	}
	while (cl->running && capacity - written >= COMMAND_LINE_ROOM) {
		struct printer printer = printer_init((char *)out + written, COMMAND_LINE_ROOM);
		command_line_step(cl, status, &printer);
		written = (size_t)((uint8_t *)printer.at - out);
	}
	if (!cl->running && cl->frame_ended && written < capacity) {
		out[written++] = COMMAND_LINE_FRAME_END;
		command_line_leave(cl);
	}
	return written;
}
