#include "hal/stm32f7/peripherals/otg.h"

#include <string.h>

#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"

#define ENDPOINTS 3u
/* Of 320 words: what came has room for seven packets with their status, the SETUP's part included (chapter "FIFO RAM
 * allocation"); the bulk endpoint's for eight. */
#define FIFO_RECEIVE_WORDS 144u
static const uint16_t fifo_words[ENDPOINTS] = { 16, 128, 16 };
_Static_assert(FIFO_RECEIVE_WORDS + 16u + 128u + 16u <= 320u, "the controller's RAM");

enum { PACKET_OUT = 2, PACKET_OUT_ENDED = 3, PACKET_SETUP_ENDED = 4, PACKET_SETUP = 6 }; /* GRXSTSP PKTSTS */
enum { FULL_SPEED = 3 };  /* DCFG DSPD: by the chip's own transceiver */
enum { TURNAROUND = 6 };  /* GUSBCFG TRDT at an AHB of 32 MHz and more (table "TRDT values") */
enum { ALL_FIFOS = 0x10 }; /* GRSTCTL TXFNUM */
enum { SETUPS_MAX = 3 };  /* DOEPTSIZ0 STUPCNT: back-to-back */
#define ENTRIES_MAX 48u   /* of the receive FIFO, taken in one call */
#define LIMIT_CORE 21600u /* 100 us: what the core answers at once (a reset takes it some cycles of its clocks) */
/* DIEPTSIZ and DOEPTSIZ, whose fields are wider from endpoint 1 on. */
#define SIZE_PACKETS BITS(19, 10)
#define SIZE_BYTES BITS(0, 19)
#define SIZE_SETUPS BITS(29, 2)
/* What a change of something else in DIEPCTL or DOEPCTL must not repeat; 0 leaves it as it is. */
#define COMMANDS (OTG_DIEPCTL_EPENA | OTG_DIEPCTL_EPDIS | OTG_DIEPCTL_SNAK | OTG_DIEPCTL_CNAK)
#define DATA0 BIT(28) /* SD0PID of both: the next packet is DATA0 */

/* The background's alone. */
static struct {
	uint8_t setup[USB_SETUP_BYTES];
	bool setup_came; /* whole, and is to be passed on */
	bool suspended;
	uint16_t packet[ENDPOINTS]; /* bytes of a packet to the host */
	uint8_t sending; /* endpoints, a bit each */
	uint8_t open;
} otg;

static bool otg_flush(uint32_t what)
{
	OTG_GRSTCTL = what;
	return time_wait(&OTG_GRSTCTL, OTG_GRSTCTL_TXFFLSH | OTG_GRSTCTL_RXFFLSH, 0, LIMIT_CORE);
}

/* --- As struct usb_controller ------------------------------------------------------------------------------------------ */
static void otg_address(void *context, unsigned address)
{
	OTG_DCFG = (OTG_DCFG & ~OTG_DCFG_DAD) | FIELD(OTG_DCFG_DAD, address);
}

static void otg_drop(void *context, unsigned endpoint)
{
	const unsigned n = endpoint & ~USB_IN;

	if ((OTG_DIEPCTL(n) & OTG_DIEPCTL_EPENA) != 0u) {
		OTG_DIEPCTL(n) = (OTG_DIEPCTL(n) & ~COMMANDS) | OTG_DIEPCTL_SNAK;
		(void)time_wait(&OTG_DIEPINT(n), OTG_DIEPINT_INEPNE, OTG_DIEPINT_INEPNE, LIMIT_CORE);
		OTG_DIEPCTL(n) = (OTG_DIEPCTL(n) & ~COMMANDS) | OTG_DIEPCTL_SNAK | OTG_DIEPCTL_EPDIS;
		(void)time_wait(&OTG_DIEPINT(n), OTG_DIEPINT_EPDISD, OTG_DIEPINT_EPDISD, LIMIT_CORE);
	}
	OTG_DIEPINT(n) = OTG_DIEPINT_EPDISD | OTG_DIEPINT_XFRC;
	(void)otg_flush(OTG_GRSTCTL_TXFFLSH | FIELD(OTG_GRSTCTL_TXFNUM, n));
	otg.sending &= (uint8_t)~(1u << n);
}

static void otg_open(void *context, unsigned endpoint, enum usb_kind kind, size_t packet_bytes)
{
	const unsigned n = endpoint & ~USB_IN;
	const uint32_t size = (uint32_t)packet_bytes | OTG_DIEPCTL_USBAEP | FIELD(OTG_DIEPCTL_EPTYP, kind) | DATA0;

	otg.open |= (uint8_t)(1u << n);
	if ((endpoint & USB_IN) == 0u) {
		OTG_DOEPCTL(n) = size | OTG_DOEPCTL_SNAK;
		return;
	}
	otg.packet[n] = (uint16_t)packet_bytes;
	OTG_DIEPCTL(n) = size | OTG_DIEPCTL_SNAK | FIELD(OTG_DIEPCTL_TXFNUM, n);
}

static void otg_close(void *context)
{
	for (unsigned n = 1; n < ENDPOINTS; ++n) {
		if ((otg.open >> n & 1u) == 0u)
			continue;
		otg_drop(NULL, USB_IN | n);
		OTG_DIEPCTL(n) = OTG_DIEPCTL_SNAK;
		/* One that takes packets is left to it: there is room for them, and to end it all others must wait. */
		OTG_DOEPCTL(n) = (OTG_DOEPCTL(n) & ~(COMMANDS | OTG_DOEPCTL_USBAEP)) | OTG_DOEPCTL_SNAK;
	}
	otg.open = 1u;
}

/* The FIFO takes words; of the last one only the bytes that belong to the packet are sent. */
static void otg_write(unsigned n, const uint8_t *bytes, size_t count)
{
	for (; count >= 4u; bytes += 4, count -= 4u) {
		uint32_t word;
		memcpy(&word, bytes, sizeof word);
		OTG_FIFO(n) = word;
	}
	if (count != 0u) {
		uint32_t word = 0;
		memcpy(&word, bytes, count);
		OTG_FIFO(n) = word;
	}
}

static size_t otg_send(void *context, unsigned endpoint, const uint8_t *bytes, size_t count)
{
	const unsigned n = endpoint & ~USB_IN;
	const size_t packet = otg.packet[n], most = 4u * fifo_words[n] / packet * packet;
	const size_t part = count < most ? count : most;
	const uint32_t packets = part == 0u ? 1u : (uint32_t)((part + packet - 1u) / packet);

	OTG_DIEPTSIZ(n) = FIELD(SIZE_PACKETS, packets) | FIELD(SIZE_BYTES, part);
	OTG_DIEPCTL(n) = (OTG_DIEPCTL(n) & ~COMMANDS) | OTG_DIEPCTL_CNAK | OTG_DIEPCTL_EPENA;
	otg_write(n, bytes, part);
	otg.sending |= (uint8_t)(1u << n);
	return part;
}

/* Sizes are not changed while a transfer is under way. */
static void otg_receive(void *context, unsigned endpoint, unsigned packets)
{
	uint32_t begin = OTG_DOEPCTL_CNAK;

	if ((OTG_DOEPCTL(endpoint) & OTG_DOEPCTL_EPENA) == 0u) {
		OTG_DOEPTSIZ(endpoint) = FIELD(SIZE_PACKETS, packets) | FIELD(SIZE_BYTES, packets * USB_PACKET_BYTES) |
					 (endpoint == 0u ? FIELD(SIZE_SETUPS, SETUPS_MAX) : 0u);
		begin |= OTG_DOEPCTL_EPENA;
	}
	OTG_DOEPCTL(endpoint) = (OTG_DOEPCTL(endpoint) & ~COMMANDS) | begin;
}

static void otg_stall(void *context, unsigned endpoint, bool stalls)
{
	const unsigned n = endpoint & ~USB_IN;
	const uint32_t change = stalls ? OTG_DIEPCTL_STALL : n == 0u ? 0u : DATA0;
	const uint32_t kept = ~(COMMANDS | OTG_DIEPCTL_STALL);

	if (n == 0u || (endpoint & USB_IN) != 0u)
		OTG_DIEPCTL(n) = (OTG_DIEPCTL(n) & kept) | change;
	if (n == 0u || (endpoint & USB_IN) == 0u)
		OTG_DOEPCTL(n) = (OTG_DOEPCTL(n) & kept) | change;
}
_Static_assert(OTG_DIEPCTL_STALL == OTG_DOEPCTL_STALL && OTG_DIEPCTL_SNAK == OTG_DOEPCTL_SNAK &&
		       OTG_DIEPCTL_EPENA == OTG_DOEPCTL_EPENA && OTG_DIEPCTL_CNAK == OTG_DOEPCTL_CNAK &&
		       OTG_DIEPCTL_USBAEP == OTG_DOEPCTL_USBAEP && OTG_DIEPCTL_EPTYP == OTG_DOEPCTL_EPTYP,
	       "both directions have the same bits");

static const struct usb_controller controller = {
	.address = otg_address,
	.open = otg_open,
	.close = otg_close,
	.send = otg_send,
	.drop = otg_drop,
	.receive = otg_receive,
	.stall = otg_stall,
};

/* --- What happened ------------------------------------------------------------------------------------------------------- */
/* A word at a time; what does not fit into `bytes` is read all the same. */
static void otg_read(uint8_t *bytes, size_t count)
{
	for (size_t at = 0; at < count; at += 4u) {
		const uint32_t word = OTG_FIFO(0);
		const size_t left = count - at, part = left < 4u ? left : 4u;

		if (at + part <= USB_PACKET_BYTES)
			memcpy(bytes + at, &word, part);
	}
}

/* Chapter "Endpoint initialization on USB reset"; what was on its way belongs to the time before. */
static void otg_reset(const struct usb_events *events)
{
	for (unsigned n = 0; n < ENDPOINTS; ++n) {
		OTG_DOEPCTL(n) = (OTG_DOEPCTL(n) & ~(COMMANDS | OTG_DOEPCTL_STALL)) | OTG_DOEPCTL_SNAK;
		OTG_DIEPCTL(n) = OTG_DIEPCTL(n) & ~(COMMANDS | OTG_DIEPCTL_STALL);
	}
	otg_drop(NULL, USB_IN);
	(void)otg_flush(OTG_GRSTCTL_TXFFLSH | FIELD(OTG_GRSTCTL_TXFNUM, ALL_FIFOS));
	(void)otg_flush(OTG_GRSTCTL_RXFFLSH);
	OTG_DCFG &= ~OTG_DCFG_DAD;
	OTG_DOEPTSIZ(0) = FIELD(SIZE_SETUPS, SETUPS_MAX);
	otg.setup_came = false;
	otg.suspended = false;
	events->reset(events->context);
}

static void otg_take_entry(const struct usb_events *events)
{
	const uint32_t entry = OTG_GRXSTSP;
	const unsigned endpoint = VALUE(OTG_GRXSTSP_EPNUM, entry);
	const size_t count = VALUE(OTG_GRXSTSP_BCNT, entry);
	uint8_t bytes[USB_PACKET_BYTES] = { 0 };

	switch (VALUE(OTG_GRXSTSP_PKTSTS, entry)) {
	case PACKET_OUT:
		otg_read(bytes, count);
		events->received(events->context, endpoint, bytes, count < sizeof bytes ? count : sizeof bytes);
		break;
	case PACKET_OUT_ENDED:
		events->ended(events->context, endpoint);
		break;
	case PACKET_SETUP:
		otg_read(bytes, count);
		memcpy(otg.setup, bytes, sizeof otg.setup);
		otg.setup_came = false;
		break;
	case PACKET_SETUP_ENDED:
		otg.setup_came = true;
		break;
	default:
		otg_read(bytes, count);
		break;
	}
}

/* Of requests that follow each other, as the host gave one up, only the last one counts. */
static void otg_take_entries(const struct usb_events *events)
{
	for (unsigned i = 0; i < ENTRIES_MAX && (OTG_GINTSTS & OTG_GINTSTS_RXFLVL) != 0u; ++i)
		otg_take_entry(events);
	if (!otg.setup_came)
		return;
	otg.setup_came = false;
	events->setup(events->context, otg.setup);
}

/* What was sent comes before what the host said then. */
static void otg_take_sent(const struct usb_events *events)
{
	for (unsigned n = 0; n < ENDPOINTS; ++n) {
		if ((OTG_DIEPINT(n) & OTG_DIEPINT_XFRC) == 0u)
			continue;
		OTG_DIEPINT(n) = OTG_DIEPINT_XFRC;
		if ((otg.sending >> n & 1u) == 0u)
			continue;
		otg.sending &= (uint8_t)~(1u << n);
		events->ended(events->context, USB_IN | n);
	}
}

bool otg_awake(void)
{
	return (OTG_DSTS & OTG_DSTS_SUSPSTS) == 0u;
}

/* No packet for 3 ms; what ends it is seen by the state alone. */
static void otg_watch_pause(const struct usb_events *events, uint32_t status)
{
	const bool paused = !otg_awake();

	if ((status & OTG_GINTSTS_USBSUSP) != 0u)
		OTG_GINTSTS = OTG_GINTSTS_USBSUSP;
	if (paused == otg.suspended)
		return;
	otg.suspended = paused;
	events->suspend(events->context, paused);
}

/* One look tells that nothing has happened. */
bool otg_poll(const struct usb_events *events)
{
	const uint32_t status = OTG_GINTSTS & (OTG_GINTSTS_USBRST | OTG_GINTSTS_ENUMDNE | OTG_GINTSTS_USBSUSP |
					       OTG_GINTSTS_RXFLVL | OTG_GINTSTS_IEPINT);

	if ((status & OTG_GINTSTS_USBSUSP) != 0u || otg.suspended)
		otg_watch_pause(events, status);
	if ((status & ~OTG_GINTSTS_USBSUSP) == 0u)
		return false;
	if ((status & OTG_GINTSTS_USBRST) != 0u) {
		OTG_GINTSTS = OTG_GINTSTS_USBRST;
		otg_reset(events);
	}
	if ((status & OTG_GINTSTS_ENUMDNE) != 0u) {
		OTG_GINTSTS = OTG_GINTSTS_ENUMDNE;
		OTG_DCTL |= OTG_DCTL_CGINAK; /* endpoint 0's packets of 64 bytes are 0 in MPSIZ */
	}
	if ((status & OTG_GINTSTS_IEPINT) != 0u)
		otg_take_sent(events);
	if ((status & OTG_GINTSTS_RXFLVL) != 0u)
		otg_take_entries(events);
	return true;
}

/* --- Start --------------------------------------------------------------------------------------------------------------- */
static bool otg_reset_core(void)
{
	if (!time_wait(&OTG_GRSTCTL, OTG_GRSTCTL_AHBIDL, OTG_GRSTCTL_AHBIDL, LIMIT_CORE))
		return false;
	OTG_GRSTCTL = OTG_GRSTCTL_CSRST;
	return time_wait(&OTG_GRSTCTL, OTG_GRSTCTL_CSRST, 0, LIMIT_CORE) &&
	       time_wait(&OTG_GRSTCTL, OTG_GRSTCTL_AHBIDL, OTG_GRSTCTL_AHBIDL, LIMIT_CORE);
}

static void otg_share_fifos(void)
{
	uint32_t at = FIFO_RECEIVE_WORDS;

	OTG_GRXFSIZ = FIELD(OTG_GRXFSIZ_RXFD, FIFO_RECEIVE_WORDS);
	for (unsigned n = 0; n < ENDPOINTS; ++n) {
		const uint32_t place = FIELD(OTG_DIEPTXF_INEPTXSA, at) | FIELD(OTG_DIEPTXF_INEPTXFD, fifo_words[n]);

		if (n == 0u)
			OTG_DIEPTXF0 = place;
		else
			OTG_DIEPTXF(n) = place;
		at += fifo_words[n];
	}
	(void)otg_flush(OTG_GRSTCTL_TXFFLSH | FIELD(OTG_GRSTCTL_TXFNUM, ALL_FIFOS));
	(void)otg_flush(OTG_GRSTCTL_RXFFLSH);
}
_Static_assert(OTG_DIEPTXF0_TX0FSA == OTG_DIEPTXF_INEPTXSA && OTG_DIEPTXF0_TX0FD == OTG_DIEPTXF_INEPTXFD,
	       "all have the same form");

/* VBUS is not sensed by the controller, whose pin is a UART's: it is told that a host is there (B-session valid). */
const struct usb_controller *otg_start(void)
{
	OTG_PCGCCTL = 0;
	if (!otg_reset_core())
		return NULL;
	OTG_GCCFG = OTG_GCCFG_PWRDWN; /* it means that the transceiver is on */
	OTG_GUSBCFG = OTG_GUSBCFG_FDMOD | FIELD(OTG_GUSBCFG_TRDT, TURNAROUND);
	OTG_GOTGCTL = OTG_GOTGCTL_BVALOEN | OTG_GOTGCTL_BVALOVAL;
	OTG_DCTL = OTG_DCTL_SDIS;
	OTG_DCFG |= FIELD(OTG_DCFG_DSPD, FULL_SPEED);
	OTG_DIEPMSK = OTG_DIEPMSK_XFRCM; /* they make IEPINT of GINTSTS, though no interrupt */
	OTG_DAINTMSK = FIELD(OTG_DAINTMSK_IEPM, BITS(0, ENDPOINTS));
	otg_share_fifos();
	otg.packet[0] = USB_PACKET_BYTES;
	otg.open = 1u;
	return &controller;
}

/* The mode that FDMOD forces takes 25 ms (register GUSBCFG); until then nothing is shown. */
bool otg_connect(bool connected)
{
	if (!connected)
		OTG_DCTL |= OTG_DCTL_SDIS;
	else if ((OTG_GINTSTS & OTG_GINTSTS_CMOD) == 0u)
		OTG_DCTL &= ~OTG_DCTL_SDIS;
	else
		return false;
	return true;
}
