/* Firmware of the board in board.yaml: when the converters are through, once per servo period, the
 * servo runs in their interrupt. Between, the processor sleeps; with AWAKE defined it never does.
 */
#include <stddef.h>

#include "board.h"
#include "control.h"
#include "converters.h"
#include "servo_joints.h"

#ifdef AWAKE
static volatile uint32_t idle_turns; /* how much time is left */
#endif

static void print(const char* text) {
  for (; *text; ++text) {
    while (!(USART2_SR & USART_TXE)) continue;
    USART2_DR = (uint8_t)*text;
  }
}

void ADC_Handler(void) {
  int64_t encoder[SERVO_JOINTS];
  uint32_t adc[SERVO_JOINTS], compare[SERVO_JOINTS];
  float q[SERVO_JOINTS];
  ADC1_SR = ~ADC_JEOC;
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    encoder[j] = (int32_t)ENCODER(j);
    adc[j] = ADC_JDR(j);
    q[j] = TARGET(j);
  }
  const int powered = (GPIOA_IDR & 3) == 2; /* power, and no fault */
  control_step(encoder, adc, TARGETS ? q : NULL, powered, compare);
  for (int j = 0; j < SERVO_JOINTS; ++j) COMPARE(j) = compare[j];
}

int main(void) {
  while (!(RCC_CR & 1u << 25)) continue; /* the PLL */
  TIM1_ARR = TIM8_ARR = PWM_TOP - 1;
  for (int j = 0; j < SERVO_JOINTS; ++j) COMPARE(j) = PWM_TOP / 2; /* 0 V */
  control_start();
  GPIOE_BSRR = 1u << 0 | 1u << 17; /* enable on, brake off */
  print("servo of " SERVO_SCENE "\r\n");
  NVIC_PRIORITY(ADC_IRQ) = 0x40;
  NVIC_ISER = 1u << ADC_IRQ;
  ADC1_CR1 = ADC_JEOCIE;
  for (;;) {
#ifdef AWAKE
    ++idle_turns;
#else
    __asm__ volatile("wfi");
#endif
  }
}
