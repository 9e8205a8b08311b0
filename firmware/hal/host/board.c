#include "hal/host/board.h"

const struct msp_identity host_identity = {
	.board = "HOST",
	.target = "HOST",
	.maker = "NRFL",
	.unique_id = { 0x484F5354u, 0, 0 }, /* "HOST" */
};
