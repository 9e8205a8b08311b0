"""OTG_FS by its registers, as a driver uses them, against what a host sees on the cable."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.usb.cable import Handshake

if TYPE_CHECKING:
    from tests.sim.board.usb.conftest import Program

OUT_DATA, OUT_DONE, SETUP_DONE, SETUP_DATA = 2, 3, 4, 6  # GRXSTSP PKTSTS
GET_DEVICE = bytes.fromhex("8006000100001200")
MS = 1000  # [us]


def test_the_device_is_seen_when_it_wants_to_be(unplugged: Program) -> None:
    otg, bench = unplugged.otg, unplugged.bench
    otg.vbus(True)
    assert bench.get("GPIOB_IDR", "IDR12") == 1
    assert not otg.attached  # SDIS is set after a reset
    unplugged.start()
    assert otg.attached
    for register, field in (
        ("DEVICE_DCTL", "SDIS"),
        ("GLOBAL_GCCFG", "PWRDWN"),
        ("GLOBAL_GOTGCTL", "BVALOVAL"),
    ):
        before = bench.get(f"OTG_FS_{register}", field)
        bench.set(f"OTG_FS_{register}", **{field: 1 - before})
        assert not otg.attached, field
        bench.set(f"OTG_FS_{register}", **{field: before})
    assert otg.attached
    otg.vbus(False)
    assert not otg.attached
    assert bench.get("GPIOB_IDR", "IDR12") == 0


def test_sessions_are_told_when_the_program_overrides_the_pin(unplugged: Program) -> None:
    unplugged.start()
    assert unplugged.has("SRQINT") and unplugged.has("BSVLD", "GLOBAL_GOTGCTL")
    unplugged.bench.set("OTG_FS_GLOBAL_GOTGCTL", BVALOVAL=0)
    assert unplugged.has("OTGINT") and unplugged.has("SEDET", "GLOBAL_GOTGINT")
    unplugged.bench.write("OTG_FS_GLOBAL_GOTGINT", 0xFFFFFFFF)
    assert not unplugged.has("OTGINT")


def test_a_reset_of_the_bus_is_told_at_its_begin_and_its_end(unplugged: Program) -> None:
    unplugged.start()
    unplugged.otg.vbus(True)
    unplugged.open()
    unplugged.otg.bus_reset()
    assert unplugged.has("USBRST") and not unplugged.has("ENUMDNE")
    assert not unplugged.has("USBAEP", "DEVICE_DIEPCTL1")  # of all endpoints but 0
    unplugged.otg.start_of_frame(5)
    assert unplugged.has("ENUMDNE") and unplugged.has("SOF")
    assert unplugged.bench.get("OTG_FS_DEVICE_DSTS", "ENUMSPD") == 3
    assert unplugged.bench.get("OTG_FS_DEVICE_DSTS", "FNSOF") == 5


def test_a_request_comes_as_data_and_as_its_end_when_the_next_token_comes(program: Program) -> None:
    otg = program.otg
    assert otg.setup(0, 0, GET_DEVICE) is Handshake.ACK
    assert program.has("RXFLVL")
    assert program.pop() == (SETUP_DATA, 0, GET_DEVICE)
    assert not program.has("RXFLVL")
    assert otg.take(0, 0) is Handshake.NAK  # nothing is ready, but the host goes on
    assert program.pop() == (SETUP_DONE, 0, b"")
    assert program.has("STUP", "DEVICE_DOEPINT0")
    assert program.bench.read("OTG_FS_GLOBAL_GRXSTSP") == 0  # an empty FIFO is no error
    program.bench.set("OTG_FS_DEVICE_DAINTMSK", IEPM=1, OEPINT=1)
    program.bench.set("OTG_FS_DEVICE_DOEPMSK", STUPM=1)
    assert program.bench.get("OTG_FS_DEVICE_DAINT", "OEPINT") == 1
    assert program.has("OEPINT") and not program.has("IEPINT")


def test_a_control_read_goes_by_toggles_from_data1_when_it_is_long(program: Program) -> None:
    otg, answer = program.otg, bytes(range(64))
    otg.setup(0, 0, GET_DEVICE)
    program.pop()
    program.send(0, answer)
    assert otg.take(0, 0) == (1, answer)
    assert program.has("XFRC", "DEVICE_DIEPINT0")
    program.send(0, b"ab")
    assert otg.take(0, 0) == (0, b"ab")
    assert otg.out(0, 0, 1, b"") is Handshake.NAK  # the status stage waits for the program
    program.receive(0, 1)
    assert otg.out(0, 0, 1, b"") is Handshake.ACK


def test_the_address_counts_when_the_status_stage_is_over(program: Program) -> None:
    otg = program.otg
    otg.setup(0, 0, bytes.fromhex("0005070000000000"))
    program.pop()
    program.bench.set("OTG_FS_DEVICE_DCFG", DAD=7)  # as the manual asks: before the status stage
    assert otg.take(7, 0) is Handshake.SILENT
    program.send(0, b"")
    assert otg.take(0, 0) == (1, b"")
    assert otg.take(0, 0) is Handshake.SILENT
    assert otg.setup(7, 0, GET_DEVICE) is Handshake.ACK
    assert otg.setup(7, 1, GET_DEVICE) is Handshake.SILENT  # no control endpoint


def test_bulk_data_from_the_host_arrives_when_the_endpoint_takes_it(program: Program) -> None:
    otg, bench = program.otg, program.bench
    assert otg.out(0, 1, 0, b"x") is Handshake.SILENT  # not active
    program.open()
    assert otg.out(0, 1, 0, b"x") is Handshake.NAK
    program.receive(1, 2)
    full = bytes(range(64))
    assert otg.out(0, 1, 0, full) is Handshake.ACK
    assert otg.out(0, 1, 0, full) is Handshake.ACK  # again: its toggle is the one before
    assert otg.out(0, 1, 1, b"end") is Handshake.ACK
    assert otg.out(0, 1, 0, b"more") is Handshake.NAK
    assert program.pop() == (OUT_DATA, 1, full)
    assert program.pop() == (OUT_DATA, 1, b"end")
    assert not program.has("XFRC", "DEVICE_DOEPINT1")
    assert program.pop() == (OUT_DONE, 1, b"")
    assert program.has("XFRC", "DEVICE_DOEPINT1")
    assert bench.get("OTG_FS_DEVICE_DOEPTSIZ1", "XFRSIZ") == 128 - 67
    assert bench.get("OTG_FS_DEVICE_DOEPTSIZ1", "PKTCNT") == 0
    assert not program.has("EPENA", "DEVICE_DOEPCTL1")
    program.receive(1, 4)
    assert otg.out(0, 1, 0, b"short") is Handshake.ACK  # ends it, three packets before its time
    assert otg.out(0, 1, 1, b"more") is Handshake.NAK
    assert [program.pop()[0] for _ in range(2)] == [OUT_DATA, OUT_DONE]


def test_the_receive_fifo_refuses_when_it_is_full_and_never_a_request_it_has_room_for(
    unplugged: Program,
) -> None:
    unplugged.start(receive=34)  # two packets with their status words, and nothing for the transfer's end
    unplugged.plug()
    unplugged.open()
    unplugged.receive(1, 8)
    packet = bytes(64)
    assert [unplugged.otg.out(0, 1, i, packet) for i in range(2)] == [Handshake.ACK, Handshake.NAK]
    assert unplugged.pop() == (OUT_DATA, 1, packet)
    assert [unplugged.otg.out(0, 1, 1 - i, packet) for i in range(2)] == [Handshake.ACK, Handshake.NAK]
    setups = [unplugged.otg.setup(0, 0, GET_DEVICE) for _ in range(6)]
    assert setups == [Handshake.ACK] * 5 + [Handshake.SILENT]  # lost: the host tries again
    unplugged.bench.set("OTG_FS_GLOBAL_GRSTCTL", RXFFLSH=1)
    unplugged.bench.context.run(2)
    assert not unplugged.has("RXFFLSH", "GLOBAL_GRSTCTL")
    assert not unplugged.has("RXFLVL")
    assert unplugged.otg.setup(0, 0, GET_DEVICE) is Handshake.ACK


def test_packets_go_to_the_host_when_they_are_whole(program: Program) -> None:
    otg, bench = program.otg, program.bench
    program.open()
    data = bytes(range(150))
    assert bench.get("OTG_FS_DEVICE_DTXFSTS1", "INEPTFSAV") == 64
    program.send(1, data, write=False)
    assert otg.take(0, 1) is Handshake.NAK
    assert program.has("ITTXFE", "DEVICE_DIEPINT1")
    for i in range(0, 100, 4):
        bench.write("OTG_FS_FIFO1_DFIFO", int.from_bytes(data[i : i + 4], "little"))
    assert bench.get("OTG_FS_DEVICE_DTXFSTS1", "INEPTFSAV") == 64 - 25
    assert otg.take(0, 1) == (0, data[:64])
    assert otg.take(0, 1) is Handshake.NAK  # 36 of 64 bytes are there
    for i in range(100, 150, 4):
        bench.write("OTG_FS_FIFO1_DFIFO", int.from_bytes(data[i : i + 4].ljust(4, b"\0"), "little"))
    assert otg.take(0, 1) == (1, data[64:128])
    assert not program.has("XFRC", "DEVICE_DIEPINT1")
    assert otg.take(0, 1) == (0, data[128:])
    assert program.has("XFRC", "DEVICE_DIEPINT1")
    assert otg.take(0, 1) is Handshake.NAK
    program.send(1, b"")
    assert otg.take(0, 1) == (1, b"")


def test_tx_empty_interrupts_when_half_or_all_of_the_fifo_is_free(program: Program) -> None:
    bench = program.bench
    program.open()
    program.send(1, bytes(256), write=False)
    bench.set("OTG_FS_DEVICE_DIEPEMPMSK", INEPTXFEM=2)
    bench.set("OTG_FS_DEVICE_DAINTMSK", IEPM=2)
    bench.set("OTG_FS_GLOBAL_GINTMSK", IEPINT=1)
    for all_free, words, expected in ((0, 0, True), (0, 32, True), (0, 33, False), (1, 33, False)):
        bench.set("OTG_FS_GLOBAL_GAHBCFG", TXFELVL=all_free)
        while 64 - bench.get("OTG_FS_DEVICE_DTXFSTS1", "INEPTFSAV") < words:
            bench.write("OTG_FS_FIFO1_DFIFO", 0)
        assert program.has("TXFE", "DEVICE_DIEPINT1") == expected
        assert program.has("IEPINT") == expected
        bench.set("OTG_FS_GLOBAL_GAHBCFG", GINT=1)
        assert bench.context.asserted("OTG_FS") == expected
        bench.set("OTG_FS_GLOBAL_GAHBCFG", GINT=0)
        assert not bench.context.asserted("OTG_FS")


def test_a_halted_endpoint_stalls_until_the_program_or_a_request_ends_it(program: Program) -> None:
    otg, bench = program.otg, program.bench
    program.open()
    program.receive(1, 1)
    bench.set("OTG_FS_DEVICE_DOEPCTL1", STALL=1)
    bench.set("OTG_FS_DEVICE_DIEPCTL1", STALL=1)
    assert otg.out(0, 1, 0, b"") is Handshake.STALL
    assert otg.take(0, 1) is Handshake.STALL
    bench.set("OTG_FS_DEVICE_DOEPCTL1", STALL=0)
    assert otg.out(0, 1, 0, b"") is Handshake.ACK
    otg.setup(0, 0, GET_DEVICE)
    bench.set("OTG_FS_DEVICE_DIEPCTL0", STALL=1)
    bench.set("OTG_FS_DEVICE_DIEPCTL0", STALL=0)  # the program cannot: "rs"
    assert otg.take(0, 0) is Handshake.STALL
    otg.setup(0, 0, GET_DEVICE)
    assert otg.take(0, 0) is Handshake.NAK


def test_an_endpoint_is_stopped_when_it_is_disabled(program: Program) -> None:
    otg, bench = program.otg, program.bench
    program.open()
    program.send(1, bytes(64))
    bench.set("OTG_FS_DEVICE_DIEPCTL1", SNAK=1)
    assert program.has("INEPNE", "DEVICE_DIEPINT1")
    assert otg.take(0, 1) is Handshake.NAK
    bench.set("OTG_FS_DEVICE_DIEPCTL1", EPDIS=1, SNAK=1)
    assert program.has("EPDISD", "DEVICE_DIEPINT1") and not program.has("EPENA", "DEVICE_DIEPCTL1")
    bench.set("OTG_FS_GLOBAL_GRSTCTL", TXFFLSH=1, TXFNUM=1)
    bench.context.run(2)
    program.send(1, b"new")
    assert otg.take(0, 1) == (0, b"new")
    program.receive(1, 1)
    with pytest.raises(BoardError, match=r"DOEPCTL1 EPDIS is set without global OUT NAK"):
        bench.set("OTG_FS_DEVICE_DOEPCTL1", EPDIS=1)
    bench.set("OTG_FS_DEVICE_DCTL", SGONAK=1)
    assert program.pop()[0] == 1 and program.has("GONAKEFF")
    assert otg.out(0, 1, 0, b"x") is Handshake.NAK
    bench.set("OTG_FS_DEVICE_DOEPCTL1", EPDIS=1)
    assert program.has("EPDISD", "DEVICE_DOEPINT1")
    bench.set("OTG_FS_DEVICE_DCTL", CGONAK=1)
    assert not program.has("GONAKEFF")
    bench.set("OTG_FS_DEVICE_DCTL", SGINAK=1)
    program.send(1, b"x")
    assert program.has("GINAKEFF") and otg.take(0, 1) is Handshake.NAK


def test_an_idle_bus_suspends_in_two_steps_and_a_resume_wakes(program: Program) -> None:
    otg, run = program.otg, program.bench.context.run
    otg.start_of_frame(2)
    run(2 * MS)
    assert not program.has("ESUSP")
    run(1 * MS + 10)
    assert program.has("ESUSP") and not program.has("USBSUSP")
    run(3 * MS)
    assert program.has("USBSUSP") and program.has("SUSPSTS", "DEVICE_DSTS")
    assert not otg.wakes
    program.bench.set("OTG_FS_DEVICE_DCTL", RWUSIG=1)
    assert otg.wakes
    otg.resume()
    assert program.has("WKUPINT") and not program.has("SUSPSTS", "DEVICE_DSTS")


def test_a_pulled_cable_looks_like_an_idle_bus_to_the_core(program: Program) -> None:
    program.otg.vbus(False)
    program.bench.context.run(6 * MS + 10)
    assert program.has("USBSUSP")
    assert program.otg.take(0, 0) is Handshake.SILENT


def test_frames_end_with_eopf_when_their_part_has_passed(program: Program) -> None:
    program.clear("EOPF")
    program.otg.start_of_frame(9)
    program.bench.context.run(790)
    assert not program.has("EOPF")
    program.bench.context.run(20)
    assert program.has("EOPF")
    program.clear("EOPF")
    program.bench.context.run(100)
    assert not program.has("EOPF")  # once a frame


def test_nothing_is_heard_when_clocks_are_gated(program: Program) -> None:
    program.bench.set("OTG_FS_PWRCLK_PCGCCTL", STPPCLK=1)
    assert program.otg.setup(0, 0, GET_DEVICE) is Handshake.SILENT
    program.bench.set("OTG_FS_PWRCLK_PCGCCTL", STPPCLK=0)
    assert program.otg.setup(0, 0, GET_DEVICE) is Handshake.ACK
    program.bench.set("RCC_AHB2ENR", OTGFSEN=0)
    assert not program.otg.attached
    with pytest.raises(
        BoardError, match=r"OTG_FS_GLOBAL_GINTSTS is read without its clock: RCC_AHB2ENR OTGFSEN"
    ):
        program.flags()


def test_resets_put_back_what_the_manual_says(program: Program) -> None:
    bench = program.bench
    program.open()
    program.otg.setup(0, 0, GET_DEVICE)
    bench.set("OTG_FS_GLOBAL_GRSTCTL", CSRST=1)
    bench.context.run(2)
    assert not program.has("CSRST", "GLOBAL_GRSTCTL")
    assert bench.get("OTG_FS_GLOBAL_GCCFG", "PWRDWN") == 1
    assert (bench.get("OTG_FS_DEVICE_DCFG", "DSPD"), bench.get("OTG_FS_DEVICE_DCTL", "SDIS")) == (3, 0)
    assert bench.read("OTG_FS_DEVICE_DIEPCTL1") == 0 and not program.has("RXFLVL")
    bench.set("RCC_AHB2RSTR", OTGFSRST=1)
    assert bench.get("OTG_FS_GLOBAL_GCCFG", "PWRDWN") == 0
    assert bench.get("OTG_FS_DEVICE_DCTL", "SDIS") == 1


def test_a_polled_register_is_asked_once_until_something_happens(program: Program) -> None:
    slot = program.bench.hardware.registers._windows[0x50000000].slots[0x14]
    asked, answer = [], slot.read

    def read() -> int:
        asked.append(program.bench.context.cycle)
        return int(answer())

    slot.read = read

    def count() -> int:
        touched = {touch.register: touch.reads for touch in program.bench.hardware.touched()}
        return int(touched["OTG_FS_GLOBAL_GINTSTS"])

    before = count()
    assert len({program.flags() for _ in range(5)}) == len(asked) == 1
    assert count() - before == 5
    program.otg.start_of_frame(7)
    assert program.has("SOF") and len(asked) == 2
    program.clear("SOF")
    assert not program.has("SOF") and len(asked) == 3
    program.bench.context.run(3100)
    assert program.has("ESUSP") and len(asked) == 4
    program.open()
    program.send(1, bytes(256), write=False)
    for _ in range(32):
        program.bench.write("OTG_FS_FIFO1_DFIFO", 0)
    assert program.has("TXFE", "DEVICE_DIEPINT1")
    program.bench.write("OTG_FS_FIFO1_DFIFO", 0)  # a word more than half of it
    assert not program.has("TXFE", "DEVICE_DIEPINT1")


def pop_unread(program: Program) -> None:
    program.otg.setup(0, 0, GET_DEVICE)
    program.bench.read("OTG_FS_GLOBAL_GRXSTSP")
    program.otg.take(0, 0)
    program.bench.read("OTG_FS_GLOBAL_GRXSTSP")


def overfill(program: Program) -> None:
    program.open()
    program.send(1, bytes(65 * 4))


def write_twice(program: Program) -> None:
    program.open()
    program.send(1, b"once")
    program.bench.write("OTG_FS_FIFO1_DFIFO", 0)


def enable_over(program: Program) -> None:
    program.open()
    program.send(1, bytes(64))
    program.bench.set("OTG_FS_DEVICE_DIEPCTL1", EPDIS=1)
    program.send(1, bytes(64))


def count_wrong(program: Program) -> None:
    program.open()
    program.bench.write("OTG_FS_DEVICE_DIEPTSIZ1", 1 << 19 | 100)
    program.bench.set("OTG_FS_DEVICE_DIEPCTL1", EPENA=1)


def overlap(program: Program) -> None:
    program.bench.write("OTG_FS_GLOBAL_DIEPTXF1", 64 << 16 | 130)
    program.open()
    program.send(1, b"")


def outgrow(program: Program) -> None:
    program.bench.write("OTG_FS_GLOBAL_DIEPTXF1", 200 << 16 | 144)
    program.open()
    program.send(1, b"")


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (pop_unread, r"GRXSTSP is read while 2 words of the packet before are in the receive FIFO"),
        (overfill, r"OTG_FS_FIFO1 is written while it is full"),
        (write_twice, r"OTG_FS_FIFO1 is written beyond the transfer's DIEPTSIZ1 XFRSIZ"),
        (enable_over, r"DIEPCTL1 EPENA is set while its FIFO holds an earlier transfer"),
        (count_wrong, r"DIEPTSIZ1 has 1 packets for 100 bytes, expected 2"),
        (overlap, r"DIEPTXF1 begins at word 130, inside OTG_FS_DIEPTXF0, which ends at 144"),
        (outgrow, r"DIEPTXF1 ends at word 344, the FIFOs' RAM has 320"),
        (lambda p: p.bench.read("OTG_FS_FIFO0_DFIFO"), r"the receive FIFO is read, but no packet's"),
        (lambda p: p.bench.write("OTG_FS_FIFO1_DFIFO", 1), r"FIFO1 is written while DIEPCTL1 EPENA is 0"),
        (lambda p: p.bench.load(0x50001004, 4), r"OTG_FS_FIFO0 has no register there"),
        (
            lambda p: p.bench.set("OTG_FS_DEVICE_DIEPCTL1", USBAEP=1, EPTYP=1, MPSIZ=64),
            r"EPTYP is isochronous, which the emulator does not model",
        ),
    ],
)
def test_a_drivers_mistake_is_named_when_it_matters(
    program: Program, mistake: Callable[[Program], Any], says: str
) -> None:
    with pytest.raises(BoardError, match=says):
        mistake(program)


@pytest.mark.parametrize(
    ("before", "says"),
    [
        (lambda p: p.start(trdt=5), r"GUSBCFG TRDT is 5, expected 6 or more with an AHB of 216 MHz"),
        (
            lambda p: (p.start(), p.bench.set("OTG_FS_DEVICE_DCFG", DSPD=0)),
            r"DCFG DSPD is 0, expected 3",
        ),
        (
            lambda p: (p.start(), p.bench.set("GPIOA_MODER", MODER12=0)),
            r"OTG_FS is on the bus: PA12 is an input, expected alternate function 10",
        ),
    ],
)
def test_a_wrong_set_up_is_named_when_the_bus_is_reset(
    unplugged: Program, before: Callable[[Program], Any], says: str
) -> None:
    before(unplugged)
    unplugged.otg.vbus(True)
    with pytest.raises(BoardError, match=says):
        unplugged.otg.bus_reset()


def test_another_clock_than_48_mhz_is_named_when_the_bus_is_reset(bench: Any) -> None:
    from tests.sim.board.usb.conftest import Program as Driver

    put = bench.set
    bench.set = lambda name, **fields: put(name, **({**fields, "PLLQ": 8} if "PLLQ" in fields else fields))
    bench.full_speed()
    driver = Driver(bench)
    driver.start()
    driver.otg.vbus(True)
    with pytest.raises(BoardError, match=r"OTG_FS is clocked with 54 MHz, expected 48 MHz"):
        driver.otg.bus_reset()


def test_the_core_goes_on_when_its_state_is_restored(program: Program) -> None:
    otg = program.otg
    program.open()
    program.send(1, b"kept")
    otg.setup(0, 0, GET_DEVICE)
    state, words = otg.state(), [device.state() for device in otg.devices]
    assert otg.take(0, 1) == (0, b"kept")
    program.pop()
    otg.restore(state)
    for device, saved in zip(otg.devices, words, strict=True):
        device.restore(saved)
    assert otg.take(0, 1) == (0, b"kept")
    assert program.pop() == (SETUP_DATA, 0, GET_DEVICE)
