"""The DMA request mapping: which requests can drive which stream and channel of DMA1 and DMA2."""

from __future__ import annotations

# Which request drives a stream on a channel: (controller, stream, channel) (RM0431 8.3.3, DMA1 and DMA2
# request mapping; where several share a place, all are named). Only peripherals that the emulator models.
REQUESTS: dict[tuple[int, int, int], tuple[str, ...]] = {
    (1, 0, 0): ("SPI3_RX",), (1, 2, 0): ("SPI3_RX",), (1, 5, 0): ("SPI3_TX",), (1, 7, 0): ("SPI3_TX",),
    (1, 3, 0): ("SPI2_RX",), (1, 4, 0): ("SPI2_TX",),
    (1, 0, 2): ("TIM4_CH1",), (1, 3, 2): ("TIM4_CH2",), (1, 6, 2): ("TIM4_UP",), (1, 7, 2): ("TIM4_CH3",),
    (1, 1, 3): ("TIM2_UP", "TIM2_CH3"), (1, 5, 3): ("TIM2_CH1",), (1, 6, 3): ("TIM2_CH2", "TIM2_CH4"),
    (1, 7, 3): ("TIM2_UP", "TIM2_CH4"),
    (1, 0, 4): ("UART5_RX",), (1, 1, 4): ("USART3_RX",), (1, 2, 4): ("UART4_RX",), (1, 3, 4): ("USART3_TX",),
    (1, 4, 4): ("UART4_TX",), (1, 5, 4): ("USART2_RX",), (1, 6, 4): ("USART2_TX",), (1, 7, 4): ("UART5_TX",),
    (1, 2, 5): ("TIM3_UP", "TIM3_CH4"), (1, 4, 5): ("TIM3_CH1",), (1, 5, 5): ("TIM3_CH2",),
    (1, 7, 5): ("TIM3_CH3",),
    (1, 0, 6): ("TIM5_UP", "TIM5_CH3"), (1, 1, 6): ("TIM5_CH4",), (1, 2, 6): ("TIM5_CH1",),
    (1, 3, 6): ("TIM5_CH4",), (1, 4, 6): ("TIM5_CH2",), (1, 6, 6): ("TIM5_UP",),
    (1, 4, 7): ("USART3_TX",),
    (2, 0, 0): ("ADC1",), (2, 4, 0): ("ADC1",), (2, 2, 0): ("TIM8_CH1", "TIM8_CH2", "TIM8_CH3"),
    (2, 6, 0): ("TIM1_CH1", "TIM1_CH2", "TIM1_CH3"),
    (2, 0, 3): ("SPI1_RX",), (2, 2, 3): ("SPI1_RX",), (2, 3, 3): ("SPI1_TX",), (2, 5, 3): ("SPI1_TX",),
    (2, 2, 4): ("USART1_RX",), (2, 5, 4): ("USART1_RX",), (2, 7, 4): ("USART1_TX",),
    (2, 1, 5): ("USART6_RX",), (2, 2, 5): ("USART6_RX",), (2, 6, 5): ("USART6_TX",),
    (2, 7, 5): ("USART6_TX",), (2, 1, 6): ("TIM1_CH1",), (2, 2, 6): ("TIM1_CH2",),
    (2, 3, 6): ("TIM1_CH1",), (2, 4, 6): ("TIM1_CH4",),
    (2, 5, 6): ("TIM1_UP",), (2, 6, 6): ("TIM1_CH3",),
    (2, 1, 7): ("TIM8_UP",), (2, 2, 7): ("TIM8_CH1",), (2, 3, 7): ("TIM8_CH2",), (2, 4, 7): ("TIM8_CH3",),
    (2, 7, 7): ("TIM8_CH4",),
}  # fmt: skip


def serves(source: str, peripheral: str) -> bool:
    """Return True if request `source` may move data of `peripheral`; a timer's, here, of ports alone."""
    owner = source.split("_")[0]
    return peripheral.startswith("GPIO") if owner.startswith("TIM") else owner == peripheral
