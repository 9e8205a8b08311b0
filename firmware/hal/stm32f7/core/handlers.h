/* Every exception handler of the image; vectors.c puts them into the table. */
#pragma once

void reset_handler(void);       /* startup.c */
void fault_handler(void);       /* fault.c: all faults, the clock's NMI and every interrupt nobody enabled */
void tick_handler(void);        /* hal.c: SysTick */
void motors_moved_handler(void);   /* motors.c: a DMA stream that writes frames and stores answers */
void motors_answers_handler(void); /* motors.c: PendSV */
void gyro_edge_handler(void);   /* gyro_chip.c: the EXTI line of its data-ready pin, or TIM5 */
void gyro_sample_handler(void); /* gyro_chip.c: the DMA stream of its SPI */
