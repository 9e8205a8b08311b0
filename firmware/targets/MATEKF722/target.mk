# A board with an STM32F722; board.h says what is connected to it.
LINKER_SCRIPT := hal/stm32f7/image.ld
include hal/stm32f7/image.mk
