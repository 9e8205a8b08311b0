/* Every exception handler of the image; vectors.c puts them into the table. */
#pragma once

void reset_handler(void);       /* startup.c */
void fault_handler(void);       /* fault.c: all faults, the clock's NMI and every interrupt nobody enabled */
void tick_handler(void);        /* hal.c: SysTick */
void gyro_edge_handler(void);   /* gyro_chip.c: EXTI3 */
void gyro_sample_handler(void); /* gyro_chip.c: DMA2 stream 2 */
