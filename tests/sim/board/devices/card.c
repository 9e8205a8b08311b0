/* A host of an SD card in miniature, after the manuals and in no way after our firmware: starts the card by polling,
 * writes block 5 and reads it back by DMA1, asleep meanwhile. */
typedef unsigned u32;
typedef unsigned char u8;

#define R(address) (*(volatile u32 *)(address))
#define R8(address) (*(volatile u8 *)(address))
enum {
	RCC = 0x40023800, GPIOB = 0x40020400, GPIOC = 0x40020800, SPI3 = 0x40003C00, DMA1 = 0x40026000, BLOCK = 512, ADDRESS = 5,
};
#define STREAM(n) (DMA1 + 0x10 + 0x18 * (n))

static u8 sent[BLOCK + 4], got[BLOCK + 4];
static volatile u32 done;
volatile u32 stage, response, equal, busy_polls, wakes;

static void until(u32 address, u32 mask, u32 value)
{
	while ((R(address) & mask) != value)
		;
}

static void speed(u32 br)
{
	R(SPI3) = 0x304u | br << 3;
	R(SPI3) |= 1u << 6;
}

static u8 byte(u8 value)
{
	R8(SPI3 + 0x0C) = value;
	until(SPI3 + 8, 1, 1);
	return R8(SPI3 + 0x0C);
}

static u8 command(u8 index, u32 argument, u8 crc)
{
	u8 answer = 0xFF;

	byte(0x40 | index);
	for (int shift = 24; shift >= 0; shift -= 8)
		byte((u8)(argument >> shift));
	byte(crc);
	for (int i = 0; i < 10 && (answer & 0x80) != 0; ++i)
		answer = byte(0xFF);
	return answer;
}

/* Both ways at once; the interrupt of the receiving stream is the end. */
static void move(u32 count)
{
	done = 0;
	R(SPI3 + 4) = 7u << 8 | 1u << 12 | 1u;
	R(STREAM(0) + 8) = R(STREAM(5) + 8) = SPI3 + 0x0C;
	R(STREAM(0) + 12) = (u32)got;
	R(STREAM(5) + 12) = (u32)sent;
	R(STREAM(0) + 4) = R(STREAM(5) + 4) = count;
	__asm volatile("dsb" ::: "memory");
	R(STREAM(0)) = 1u << 10 | 1u << 4 | 1u;
	R(STREAM(5)) = 1u << 10 | 1u << 6 | 1u;
	R(SPI3 + 4) |= 2u;
	while (!done) {
		++wakes;
		__asm volatile("wfi");
	}
	R(DMA1 + 0x0C) = 0x3Du << 6; /* HIFCR, stream 5 */
	R(SPI3 + 4) = 7u << 8 | 1u << 12;
}

__attribute__((used)) void stream_handler(void)
{
	R(DMA1 + 0x08) = 0x3Du; /* LIFCR, stream 0 */
	done = 1;
	__asm volatile("dsb");
}

__attribute__((used)) void reset(void)
{
	stage = response = equal = busy_polls = wakes = 0; /* nothing clears .bss */
	R(RCC + 0x30) |= 1u << 1 | 1u << 2 | 1u << 21;
	R(RCC + 0x40) |= 1u << 15;
	(void)R(RCC + 0x40);
	R(GPIOB + 0x20) = (R(GPIOB + 0x20) & ~0xFFF000u) | 0x666000u;
	R(GPIOB) = (R(GPIOB) & ~0xFC0u) | 0xA80u;
	R(GPIOC + 0x18) = 1u << 1;
	R(GPIOC) = (R(GPIOC) & ~0xCu) | 0x4u;
	R(0xE000E100) = 1u << 11;
	R(SPI3 + 4) = 7u << 8 | 1u << 12;
	speed(5); /* 250 kHz of 16 MHz */
	for (int i = 0; i < 60; ++i)
		byte(0xFF);
	R(GPIOC + 0x18) = 1u << 17;
	stage = 1;
	if (command(0, 0, 0x95) != 1)
		goto rest;
	stage = 2;
	command(8, 0x1AA, 0x87);
	for (int i = 0; i < 4; ++i)
		byte(0xFF);
	do
		command(55, 0, 0);
	while (command(41, 1u << 30, 0) != 0);
	stage = 3;
	speed(0); /* 8 MHz */
	if (command(24, ADDRESS, 0) != 0)
		goto rest;
	sent[0] = 0xFF;
	sent[1] = 0xFE;
	for (int i = 0; i < BLOCK; ++i)
		sent[i + 2] = (u8)(i * 7 + i / 256);
	move(BLOCK + 4);
	response = byte(0xFF) & 0x1Fu;
	while (byte(0xFF) != 0xFF)
		++busy_polls;
	stage = 4;
	if (command(17, ADDRESS, 0) != 0)
		goto rest;
	while (byte(0xFF) != 0xFE)
		;
	for (int i = 0; i < BLOCK + 4; ++i)
		sent[i] = 0xFF;
	move(BLOCK + 2);
	for (int i = 0; i < BLOCK; ++i)
		equal += got[i] == (u8)(i * 7 + i / 256);
	stage = 5;
rest:
	R(GPIOC + 0x18) = 1u << 1;
	for (;;)
		__asm volatile("wfi");
}

__attribute__((section(".vectors"), used)) void *const vectors[16 + 104] = {
	[0] = (void *)0x20010000, [1] = (void *)reset, [16 + 11] = (void *)stream_handler,
};
