/* Vector table and what happens before main. */
#include <stdint.h>

extern uint32_t stack_top, data_load, data_begin, data_end, bss_begin, bss_end;
int main(void);

void Reset_Handler(void) {
  *(volatile uint32_t*)0xe000ed88 |= 0xfu << 20; /* the FPU on */
  __asm__ volatile("dsb\n isb");
  const uint32_t* from = &data_load;
  for (volatile uint32_t* to = &data_begin; to < &data_end;) *to++ = *from++;
  for (volatile uint32_t* to = &bss_begin; to < &bss_end;) *to++ = 0;
  main();
  for (;;) continue;
}

void Default_Handler(void) {
  for (;;) continue;
}

#define OTHERWISE __attribute__((weak, alias("Default_Handler")))
OTHERWISE void NMI_Handler(void);
OTHERWISE void HardFault_Handler(void);
OTHERWISE void SVC_Handler(void);
OTHERWISE void PendSV_Handler(void);
OTHERWISE void SysTick_Handler(void);
OTHERWISE void ADC_Handler(void);

typedef void (*handler)(void);
__attribute__((section(".vectors"), used)) static const handler vectors[16 + 82] = {
    [0] = (handler)&stack_top, [1] = Reset_Handler,     [2] = NMI_Handler,
    [3] = HardFault_Handler,   [11] = SVC_Handler,      [14] = PendSV_Handler,
    [15] = SysTick_Handler,    [16 + 18] = ADC_Handler,
};
