// Impact sensor and elevator pulses onto CAN: ESP32 with its own controller (TWAI) and a 3.3 V transceiver, 250 kbit/s.
// Bridge amplifier (0 to 3.3 V) on GPIO 34, shaft sensor (8 pulses a turn) on GPIO 27, transceiver on GPIO 5 (TX) and 4 (RX).
#include "driver/twai.h"

const int BRIDGE = 34, SHAFT = 27;
const uint32_t SPACING_US = 2000;
volatile uint16_t pulses = 0;
uint16_t samples[3];
uint8_t filled = 0, count = 0;
uint32_t next_us;

void IRAM_ATTR pulse() { pulses++; }

void setup() {
  analogReadResolution(12);
  pinMode(SHAFT, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(SHAFT), pulse, RISING);
  twai_general_config_t general = TWAI_GENERAL_CONFIG_DEFAULT(GPIO_NUM_5, GPIO_NUM_4, TWAI_MODE_NORMAL);
  twai_timing_config_t timing = TWAI_TIMING_CONFIG_250KBITS();
  twai_filter_config_t filter = TWAI_FILTER_CONFIG_ACCEPT_ALL();
  twai_driver_install(&general, &timing, &filter);
  twai_start();
  next_us = micros();
}

void loop() {
  if ((int32_t)(micros() - next_us) < 0) return;
  next_us += SPACING_US;
  samples[filled++] = analogRead(BRIDGE);
  if (filled < 3) return;
  filled = 0;
  uint64_t bits = (uint64_t)samples[0] | (uint64_t)samples[1] << 12 | (uint64_t)samples[2] << 24;
  twai_message_t frame = {};
  frame.identifier = 0x300;
  frame.data_length_code = 8;
  frame.data[0] = count++;
  frame.data[1] = pulses & 0xFF;
  frame.data[2] = pulses >> 8;
  for (int i = 0; i < 5; i++) frame.data[3 + i] = bits >> (8 * i) & 0xFF;
  twai_transmit(&frame, 0);
}
