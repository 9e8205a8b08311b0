#include "command_line/session.h"

uint32_t command_samples(const struct command_line *cl)
{
	return cl->services->samples(cl->services->context);
}

void command_stop_motor(struct command_line *cl)
{
	cl->motor.turning = 0;
	(void)cl->services->motor_test(cl->services->context, NULL, 0);
}

void command_line_stop(struct command_line *cl)
{
	if (cl->motor.turning)
		command_stop_motor(cl);
}

void command_line_clear(struct command_line *cl)
{
	cl->length = 0;
	cl->line[0] = '\0';
	cl->fault = COMMAND_LINE_GOOD;
}

void command_line_leave(struct command_line *cl)
{
	if (cl->mode == COMMAND_LINE_CLOSED)
		return;
	command_line_stop(cl);
	cl->motor.allowed = false;
	command_line_clear(cl);
	cl->running = NULL;
	cl->frame_ended = false;
	cl->mode = COMMAND_LINE_CLOSED;
	(void)cl->services->session(cl->services->context, false);
}
