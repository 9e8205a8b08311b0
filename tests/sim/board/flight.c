/* A firmware in miniature, after the manual and in no way after ours: 216 MHz, the gyro chip by polling and then
 * by DMA at every second data-ready edge, four motors by DShot600 from what was read, a line that answers.
 * Motor i gets 48 + (16-bit counts of axis i mod 3) mod 2000. */
typedef unsigned u32;
typedef unsigned char u8;
typedef unsigned short u16;

#define R(address) (*(volatile u32 *)(address))
#define R8(address) (*(volatile u8 *)(address))
enum {
	RCC = 0x40023800, PWR = 0x40007000, FLASH = 0x40023C00, GPIOA = 0x40020000, GPIOC = 0x40020800,
	SPI1 = 0x40013000, TIM8 = 0x40010400, DMA1 = 0x40026000, DMA2 = 0x40026400, EXTI = 0x40013C00,
	SYSCFG = 0x40013800, USART2 = 0x40004400,
};
#define STREAM(dma, n) ((dma) + 0x10 + 0x18 * (n))

extern u32 bss_start[], bss_end[];

static u8 request[15], response[15];
static u32 words[50]; /* three a bit: pulses begin, those of zeros end, the others end; then rest */
static u8 ring[64];
static volatile u32 edges;
volatile u32 samples, received;

static void barrier(void)
{
	__asm volatile("dsb" ::: "memory");
}

static void until(u32 address, u32 mask, u32 value)
{
	while ((R(address) & mask) != value)
		;
}

static void pause_us(u32 us)
{
	const u32 start = R(0xE0001004);

	while (R(0xE0001004) - start < us * 216u)
		;
}

static void clocks(void)
{
	R(RCC) |= 1u << 16;
	until(RCC, 1u << 17, 1u << 17);
	R(RCC) |= 1u << 19;
	R(RCC + 0x40) |= 1u << 28;
	(void)R(RCC + 0x40);
	R(RCC + 0x04) = 0x20000000u | 9u << 24 | 1u << 22 | 0u << 16 | 216u << 6 | 4u;
	R(RCC) |= 1u << 24;
	R(PWR) |= 1u << 16;
	until(PWR + 4, 1u << 16, 1u << 16);
	R(PWR) |= 1u << 17;
	until(PWR + 4, 1u << 17, 1u << 17);
	R(FLASH) = 7u | 1u << 8 | 1u << 9;
	R(RCC + 0x08) = 5u << 10 | 4u << 13;
	until(RCC, 1u << 25, 1u << 25);
	R(RCC + 0x08) |= 2u;
	until(RCC + 0x08, 3u << 2, 2u << 2);
	R(RCC + 0x30) |= 1u << 0 | 1u << 2 | 1u << 21 | 1u << 22;
	R(RCC + 0x40) |= 1u << 17;
	R(RCC + 0x44) |= 1u << 1 | 1u << 12 | 1u << 14;
	(void)R(RCC + 0x44);
}

static u8 spi_byte(u8 byte)
{
	R8(SPI1 + 0x0C) = byte;
	until(SPI1 + 8, 1, 1);
	return R8(SPI1 + 0x0C);
}

static u8 chip(u8 address, u8 value)
{
	R(GPIOC + 0x18) = 1u << 18;
	spi_byte(address);
	const u8 answer = spi_byte(value);

	until(SPI1 + 8, 1u << 7, 0);
	R(GPIOC + 0x18) = 1u << 2;
	return answer;
}

static void gyro(void)
{
	static const u8 settings[][2] = {{0x6A, 0x10}, {0x6B, 1}, {0x1A, 0}, {0x1B, 0x18}, {0x1C, 0x18}, {0x38, 1}};

	R(GPIOA + 0x20) |= 0x55500000u;
	R(GPIOA) |= 0xA800u;
	R(GPIOC + 0x18) = 1u << 2;
	R(GPIOC) |= 1u << 4;
	R(SPI1) = 0x307u | 6u << 3;
	R(SPI1 + 4) = 7u << 8 | 1u << 12;
	R(SPI1) |= 1u << 6;
	pause_us(1100);
	chip(0x6B, 0x80);
	pause_us(2100);
	if (chip(0x75 | 0x80, 0) != 0x70)
		for (;;)
			;
	for (u32 i = 0; i < sizeof settings / 2; ++i)
		chip(settings[i][0], settings[i][1]);
	R(SPI1) &= ~(1u << 6);
	R(SPI1) = 0x307u | 2u << 3;
	request[0] = 0x3B | 0x80;
	R(SYSCFG + 8) = 2u << 12;
	R(EXTI + 8) = 8;
	R(EXTI) = 8;
	R(STREAM(DMA2, 2) + 8) = SPI1 + 0x0C;
	R(STREAM(DMA2, 3) + 8) = SPI1 + 0x0C;
	R(STREAM(DMA2, 2) + 12) = (u32)response;
	R(STREAM(DMA2, 3) + 12) = (u32)request;
	R8(0xE000E400 + 58) = 0x20; /* below the edge */
	R(0xE000E100) = 1u << 9;
	R(0xE000E104) = 1u << 26; /* interrupt 58 */
}

static void motors(void)
{
	R(GPIOC) |= 0x55000u;
	R(TIM8 + 0x2C) = 119;
	R(TIM8 + 0x14) = 1;
	R(TIM8) = 0x81;
	R(STREAM(DMA2, 1) + 8) = GPIOC + 0x18;
	R(STREAM(DMA2, 1) + 12) = (u32)words;
}

static void receiver(void)
{
	R(GPIOA + 0x20) |= 7u << 12;
	R(GPIOA) |= 2u << 6;
	R(STREAM(DMA1, 5) + 8) = USART2 + 0x24;
	R(STREAM(DMA1, 5) + 12) = (u32)ring;
	R(STREAM(DMA1, 5) + 4) = sizeof ring;
	R(STREAM(DMA1, 5)) = 4u << 25 | 1u << 10 | 1u << 8;
	barrier();
	R(STREAM(DMA1, 5)) |= 1;
	R(USART2 + 0x0C) = 540;
	R(USART2 + 4) = 2u << 12 | 1u << 16;
	R(USART2 + 8) = 1u << 12 | 1u << 6;
	R(USART2) = 1u << 2 | 1u << 12 | 1u << 10;
	R(USART2) |= 1;
}

static void send(const u16 values[4])
{
	for (u32 bit = 0; bit < 16; ++bit) {
		words[3 * bit] = 15u << 6;
		words[3 * bit + 1] = 0;
		words[3 * bit + 2] = 15u << 22;
	}
	for (u32 motor = 0; motor < 4; ++motor) {
		const u32 data = (u32)values[motor] << 1;
		const u32 frame = data << 4 | ((data ^ data >> 4 ^ data >> 8) & 15u);

		for (u32 bit = 0; bit < 16; ++bit)
			words[3 * bit + 1] |= (frame >> (15 - bit) & 1u ? 0u : 1u) << (22 + motor);
	}
	R(TIM8 + 0x0C) = 0;
	R(TIM8 + 0x24) = 0;
	R(DMA2 + 8) = 0x3Du << 6;
	R(STREAM(DMA2, 1) + 4) = 50;
	R(STREAM(DMA2, 1)) = 7u << 25 | 2u << 13 | 2u << 11 | 1u << 10 | 1u << 6;
	barrier();
	R(STREAM(DMA2, 1)) |= 1;
	R(TIM8 + 0x0C) = 1u << 8;
}

void edge(void)
{
	R(EXTI + 0x14) = 8;
	if (edges++ & 1u)
		return;
	R(GPIOC + 0x18) = 1u << 18;
	R(SPI1 + 4) = 7u << 8 | 1u << 12 | 1u;
	R(STREAM(DMA2, 2) + 4) = R(STREAM(DMA2, 3) + 4) = 15;
	R(STREAM(DMA2, 2)) = 3u << 25 | 1u << 10 | 1u << 4;
	R(STREAM(DMA2, 3)) = 3u << 25 | 1u << 10 | 1u << 6;
	barrier();
	R(STREAM(DMA2, 2)) |= 1;
	R(STREAM(DMA2, 3)) |= 1;
	R(SPI1 + 4) |= 2;
	R(SPI1) |= 1u << 6;
}

void sample(void)
{
	u16 values[4];

	R(SPI1) &= ~(1u << 6);
	R(SPI1 + 4) = 7u << 8 | 1u << 12;
	R(DMA2 + 8) = 0x3Du << 16 | 0x3Du << 22;
	R(GPIOC + 0x18) = 1u << 2;
	for (u32 i = 0; i < 4; ++i) {
		const u32 at = 9 + 2 * (i % 3);

		values[i] = (u16)(48u + ((u32)response[at] << 8 | response[at + 1]) % 2000u);
	}
	send(values);
	++samples;
	received = sizeof ring - R(STREAM(DMA1, 5) + 4);
}

void reset(void)
{
	for (u32 *word = bss_start; word != bss_end; ++word)
		*word = 0;
	R(0xE000EDFC) |= 1u << 24;
	R(0xE0001FB0) = 0xC5ACCE55u;
	R(0xE0001000) |= 1u;
	clocks();
	motors();
	receiver();
	gyro();
	for (;;)
		__asm volatile("wfi");
}

__attribute__((section(".vectors"), used)) void (*const vectors[16 + 104])(void) = {
	[0] = (void (*)(void))0x20010000, [1] = reset, [16 + 9] = edge, [16 + 58] = sample,
};
