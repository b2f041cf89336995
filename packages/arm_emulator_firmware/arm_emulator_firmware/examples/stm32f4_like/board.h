/* The registers of board.yaml, and what they are in SI units. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#define REGISTER(at) (*(volatile uint32_t*)(at))

#define RCC_CR REGISTER(0x40023800)
#define ENCODER(j) REGISTER(0x40000024 + 0x400 * (j))
#define ADC1_SR REGISTER(0x40012000)
#define ADC1_CR1 REGISTER(0x40012004)
#define ADC_JEOC (1u << 2)
#define ADC_JEOCIE (1u << 7)
#define ADC_JDR(j) REGISTER(0x4001203c + 0x100 * ((j) / 2) + 4 * ((j) % 2))
#define TIM1_ARR REGISTER(0x4001002c)
#define TIM8_ARR REGISTER(0x4001042c)
#define COMPARE(j) REGISTER((j) < 4 ? 0x40010034 + 4 * (j) : 0x40010434 + 4 * ((j) - 4))
#define GPIOA_IDR REGISTER(0x40020010)
#define GPIOE_BSRR REGISTER(0x40021018)
#define USART2_SR REGISTER(0x40004400)
#define USART2_DR REGISTER(0x40004404)
#define USART_TXE (1u << 7)
#define TARGETS REGISTER(0x60003000)
#define TARGET(j) (*(volatile float*)(0x60003004 + 4 * (j)))
#define NVIC_ISER REGISTER(0xe000e100)
#define NVIC_PRIORITY(n) (*(volatile uint8_t*)(0xe000e400 + (n)))
#define SCB_CPACR REGISTER(0xe000ed88)

enum { ADC_IRQ = 18 };

#endif
