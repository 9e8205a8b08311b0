/* The table of commands. */
#ifndef NF_COMMANDS_H
#define NF_COMMANDS_H

#include <stddef.h>

#include "command_line/command.h"

extern const struct command command_table[];
extern const size_t command_count;

/* Returns the command that `line` begins with, or NULL. *arguments is set to the text after it. */
const struct command *command_find(const char *line, const char **arguments);

#endif
