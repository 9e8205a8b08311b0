/* Every exception handler of the image; vectors.c puts them into the table. */
#ifndef STM32F7_HANDLERS_H
#define STM32F7_HANDLERS_H

void reset_handler(void);       /* startup.c */
void fault_handler(void);       /* stop.c: all faults, the clock's NMI and every interrupt nobody enabled */
void tick_handler(void);        /* time.c: SysTick */
void gyro_edge_handler(void);   /* gyro_mpu6500.c: EXTI3 */
void gyro_sample_handler(void); /* gyro_mpu6500.c: DMA2 stream 2 */

#endif
