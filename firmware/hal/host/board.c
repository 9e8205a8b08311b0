#include "hal/host/board.h"

const struct msp_identity host_identity = {
	.board = "HOST",
	.target = "HOST",
	.maker = "NRFL",
	.unique_id = { 0x484F5354u, 0, 0 }, /* "HOST" */
};

struct firmware_config host_config(unsigned gyro_rate_hz)
{
	return (struct firmware_config){
		.gyro_rate_hz = gyro_rate_hz,
		.alignment = ALIGN_CW180,
	};
}
