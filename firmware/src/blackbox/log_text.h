/* Texts of a log's header, put behind one another. The caller has room. */
#ifndef NF_LOG_TEXT_H
#define NF_LOG_TEXT_H

#include <stddef.h>
#include <stdint.h>

void log_text(char **at, const char *text);
void log_text_number(char **at, int32_t value);
void log_text_whole(char **at, uint32_t value);
void log_text_hex(char **at, uint32_t value); /* 8 digits */
void log_text_bytes(char **at, const void *bytes, size_t count); /* 2 digits each */
void log_text_float(char **at, float value);

#endif
