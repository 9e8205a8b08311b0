"""The signals of the processor's peripherals on a board's pins, and the alternate functions that they need.

The table is the data sheet's (DS11853, alternate function mapping) for what the emulator models, without the
pins of packages with more than 64; ST's own list of the pins of the STM32F722RETx says the same
(STM32_open_pin_data). It is no part of what an image says of its board, so that the two can disagree.
"""

from __future__ import annotations

from neuroflight.toolchain.boards.facts import Board, Pin

ANALOG = -1  # in place of an alternate function

FUNCTIONS: dict[str, dict[str, int]] = {
    "SPI1_SCK": {"PA5": 5, "PB3": 5},
    "SPI1_MISO": {"PA6": 5, "PB4": 5},
    "SPI1_MOSI": {"PA7": 5, "PB5": 5},
    "SPI2_SCK": {"PA9": 5, "PB10": 5, "PB13": 5, "PD3": 5},
    "SPI2_MISO": {"PB14": 5, "PC2": 5},
    "SPI2_MOSI": {"PB15": 5, "PC1": 5, "PC3": 5},
    "SPI3_SCK": {"PB3": 6, "PC10": 6},
    "SPI3_MISO": {"PB4": 6, "PC11": 6},
    "SPI3_MOSI": {"PB2": 7, "PB5": 6, "PC12": 6, "PD6": 5},
    "USART1_TX": {"PA9": 7, "PB6": 7},
    "USART1_RX": {"PA10": 7, "PB7": 7},
    "USART2_TX": {"PA2": 7, "PD5": 7},
    "USART2_RX": {"PA3": 7, "PD6": 7},
    "USART3_TX": {"PB10": 7, "PC10": 7, "PD8": 7},
    "USART3_RX": {"PB11": 7, "PC11": 7, "PD9": 7},
    "UART4_TX": {"PA0": 8, "PC10": 8},
    "UART4_RX": {"PA1": 8, "PC11": 8},
    "UART5_TX": {"PC12": 8},
    "UART5_RX": {"PD2": 8},
    "USART6_TX": {"PC6": 8},
    "USART6_RX": {"PC7": 8},
    "OTG_FS_DM": {"PA11": 10},
    "OTG_FS_DP": {"PA12": 10},
    # Of the converter (data sheet, pin definitions).
    **{f"ADC1_IN{i}": {f"PA{i}": ANALOG} for i in range(8)},
    **{f"ADC1_IN{8 + i}": {f"PB{i}": ANALOG} for i in range(2)},
    **{f"ADC1_IN{10 + i}": {f"PC{i}": ANALOG} for i in range(6)},
}
CONVERTED = {
    pin: int(name.removeprefix("ADC1_IN"))
    for name in FUNCTIONS
    if name.startswith("ADC1")
    for pin in FUNCTIONS[name]
}

Signals = dict[str, tuple[Pin, int]]  # pin and alternate function, or ANALOG


def uart_name(number: int) -> str:
    """Return the manual's name of USART or UART 1 to 6."""
    return f"{'UART' if number in (4, 5) else 'USART'}{number}"


def board_signals(board: Board) -> Signals:
    """Return where the board leads each signal to. What is not in it is led nowhere.

    A pin that has no such function, an error of the board's description, is led nowhere, too.
    """
    found: dict[str, Pin | None] = {"OTG_FS_DM": Pin("A", 11), "OTG_FS_DP": Pin("A", 12)}
    for number, bus in board.buses.items():
        found |= {f"SPI{number}_{line}": getattr(bus, line.lower()) for line in ("SCK", "MISO", "MOSI")}
    for number, uart in board.uarts.items():
        found |= {f"{uart_name(number)}_TX": uart.tx, f"{uart_name(number)}_RX": uart.rx}
    for pin in (board.volts, board.amps):
        if pin is not None and str(pin) in CONVERTED:
            found[f"ADC1_IN{CONVERTED[str(pin)]}"] = pin
    return {
        name: (pin, FUNCTIONS[name][str(pin)])
        for name, pin in found.items()
        if pin is not None and str(pin) in FUNCTIONS[name]
    }
