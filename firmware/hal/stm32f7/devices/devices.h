/* The devices on the board's lines, each for hal.c: set up once, then at work for struct hal or the handlers. */
#pragma once

#include "port/hal.h"
#include "port/serial_line.h"
#include "storage/card/sd_card.h"
#include "usb/usb_device.h"

/* --- Motors by DShot on any pins of up to three ports: DMA writes the ports, paced by TIM1. --- */
/* The timer runs, no frame yet. `protocol`: NF_MOTOR_PROTOCOL_...; `telemetry`: ESCs answer each frame on its line
 * (bidirectional DShot); `count`: motors in use, at most board.motor_count; the lines of the others stay low. Once, after
 * motor_pins_start. */
void motors_run(uint32_t protocol, bool telemetry, size_t count);

/* As motors_write of struct hal: sends one frame to every motor in use (26.7 us with DShot600); missing values send a
 * stop. Dropped, and false, while the last frame or its answers are still on the wire, and before motors_run: with
 * telemetry that is 99 us (DShot600), 161 (DShot300), 282 (DShot150). At the fourth write in a row that it would be, the
 * output has stuck and is set up anew. From the sample handler or the tick only. */
bool motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry);

/* As rotors_read of struct hal: the answers to the last frame whose answers are over. From the sample handler only. */
void motors_read(void *context, uint16_t words[NF_MOTOR_COUNT_MAX]);

/* Waits for the end of the frame that is on the wire, 200 us at most; with interrupts off no other one follows. */
void motors_finish(void);

/* As motor_restarts of struct hal: how often outputs that had stuck were set up anew since boot. */
uint32_t motors_restarts(void *context);

/* --- The gyro chip on its SPI, one of gyro_kinds.c: data-ready at 8 kHz, every n-th edge read by DMA. --- */
struct gyro_found {
	enum gyro_chip kind; /* left alone where it is not known */
	uint8_t identity; /* what it said, as it was read: also of a chip that is not known; 0xFF where none answers */
};

/* Identifies and configures the chip at `place` of the board's description (takes 0.3 s). False: absent, unknown, none that this firmware can fly, or it does
 * not keep what is written to it. Needs the clocks at full speed. */
bool gyro_start(const struct board_chip *place, struct gyro_found *found);

/* From now on `handlers->sample` gets `rate_hz` samples a second (one of NF_GYRO_RATES_HZ), from interrupts, and
 * `handlers->gyro_silent` is called whenever NF_GYRO_BAD_MS pass without one: also where gyro_start failed. */
void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz);

/* Samples taken so far, wraps at 2^32. */
uint32_t gyro_samples(void);

/* A millisecond has passed. From the tick, which shares the samples' priority. */
void gyro_tick(void);

/* --- The receiver's line: SBUS (inverted, 100 kbaud, 8E2) or CRSF (416,666 baud, 8N1). --- */
/* `protocol`: NF_RECEIVER_PROTOCOL_...; a protocol that does not use the line leaves it off. */
void receiver_line_start(uint32_t protocol);

/* As receiver_read of struct hal: bytes since the last call, at most `capacity`. SBUS has no checksum, so there a
 * parity or framing error discards the bytes read with it and the rest of its frame. From the sample handler only. */
size_t receiver_line_read(void *context, uint8_t *bytes, size_t capacity);

/* --- Battery voltage and current at their pins: ADC1 converts both continuously, DMA stores the last conversions. --- */
void power_start(void);

/* As power_read of struct hal: the mean of the last 1.2 ms; invalid where conversions have not filled that since the
 * last call. */
void power_read(void *context, struct power_sample *power);

/* --- MSP's ports, whatever line each has. Background only. --- */
/* Port 0..NF_MSP_PORT_COUNT - 1 begins, on that line. */
void msp_lines_start(unsigned port, struct serial_line line);

/* Serves what has come by the ports that have begun since the last call, and sends what is said unasked; waits for
 * nothing. */
void msp_lines_serve(const struct hal_handlers *handlers);

/* Sends what is left to be sent, and takes no more requests. Returns whether a bit of it is not yet on a line. */
bool msp_lines_finish(void);

/* --- The UARTs of MSP's ports 0 and 1, 8N1. Background only. --- */
/* Sets it up at `baud`, one of NF_MSP_BAUDS or NF_LOG_BAUDS: for MSP, or for something else. What came before is lost. False: the
 * board does not have it. */
bool msp_uart_open(unsigned number, uint32_t baud, struct serial_line *line);

/* --- The USB connector, polled. Background only. --- */
/* Clocks, pins and controller; nothing is shown to a host yet. NULL: the controller does not answer. Then usb_bus_serve
 * says what the host finds: a device for `function`, whose name is `product`; both outlive the program. */
const struct usb_controller *usb_bus_start(void);
struct usb_device *usb_bus_device(void);
void usb_bus_serve(const struct usb_function *function, const char *product);

/* Does the board see a cable: its supply, or where it cannot measure that a host's traffic? After usb_bus_start. */
bool usb_bus_seen(void);

/* What is not seen for so long is not there. */
uint32_t usb_bus_patience_ms(void);

/* Passes on what has happened on the bus. Returns whether more may come within the millisecond: do not sleep. */
bool usb_bus_step(void);

/* MSP's line by USB: *line. False: there is none. */
bool usb_line_open(const char *product, struct serial_line *line);

/* The SD card as a disk that can only be read, until the cable is out or the host ejects it: nothing else runs but the tick,
 * which sends stop frames to the motors. */
void usb_card_run(void);

/* --- A log on the UART of MSP's second port, where the pilot has set it so: what it is written to is somebody
 * else's matter. Background only. --- */
/* The line, 8N1, at one of NF_LOG_BAUDS. MSP must not have that port. NULL: the board has none. */
const struct log_device *log_uart_start(uint32_t baud);

/* --- Logs on the SD card or flash chip, by DMA and without an interrupt. Background only. --- */
/* Pins and SPI are set up; looking for it is left to the device's step. NULL: the board has no place for one. */
const struct log_device *log_spi_start(void);

/* Has the board a slot for a card? */
bool log_spi_has_card(void);

/* Its bus alone, for something else that uses the chip. NULL: as above. */
const struct spi_bus *log_spi_open(void);
