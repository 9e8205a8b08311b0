/* Replies that several commands share, and functions that read arguments. */
#ifndef NF_REPLY_H
#define NF_REPLY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "command_line/command.h"

#define COMMAND_ERROR "###ERROR " /* so begins every line that tells an error */

/* Begins a line that tells an error: `save` is refused from here on. Its own errors change nothing there: it may be
 * tried again. */
void command_error(const struct task_line *t);

/* Begins an error of command `name` about its argument `got`, cut where it is long: what was got stands there, what was
 * expected is to follow. */
void command_got(const struct task_line *t, const char *name, const char *got);

/* Ends an error line about what may come from a diff of Betaflight's: says who takes that. */
void command_end_foreign(const struct task_line *t);

/* Ends an error line about armed motors or a motor test. */
void command_say_armed(const struct task_line *t);

/* Name and hash of the policy. */
void command_say_policy(const struct task_line *t);
void command_say_version(const struct task_line *t);

/* Characters of `word` if `line` begins with it and a space or nothing follows; else 0. */
size_t command_word(const char *line, const char *word);

/* The first character that is no space. */
const char *command_skip_spaces(const char *text);

/* Is `text` exactly the word `word`? */
bool command_is(const char *text, const char *word);

/* Reads digits alone. Returns what stands behind them and the spaces after them; NULL: there are none, or too many. */
const char *command_number(const char *text, uint32_t *value);

#endif
