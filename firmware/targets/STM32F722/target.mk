# A board with an STM32F722; its description says what is connected to it.
include hal/stm32f7/image.mk
