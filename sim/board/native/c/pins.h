/* GPIO and EXTI. */
#ifndef NATIVE_PINS_H
#define NATIVE_PINS_H

#include "native.h"

enum { MODER = 0, OTYPER = 1, PUPDR = 3, IDR = 4, ODR = 5, BSRR = 6 }; /* words of GPIO */

void exti_update(struct native *n);
bool exti_watches_fall(const struct native *n, uint32_t line);
void exti_write(struct native *n, uint32_t word, uint32_t value);
void pins_tell(struct native *n, uint32_t port); /* its watched pins' levels, where they have changed */
void pins_pulse(struct native *n, uint32_t port, uint32_t pin);
uint32_t pins_read(struct native *n, uint32_t device, uint32_t word);
void pins_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);

#endif
