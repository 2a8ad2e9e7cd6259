// As much of an Arduino Uno as the sketch uses, on a clock that only the board's own work moves.
#pragma once
#include <stddef.h>
#include <stdint.h>

constexpr uint8_t A0 = 14;
constexpr uint8_t OUTPUT = 1;

void pinMode(uint8_t pin, uint8_t mode);
int analogRead(uint8_t pin);
void analogWrite(uint8_t pin, int value);
unsigned long millis();
unsigned long micros();

struct Port {
  void begin(unsigned long baud);
  int available();
  int read();
  int availableForWrite();
  size_t write(const uint8_t* bytes, size_t size);
};
extern Port Serial;
