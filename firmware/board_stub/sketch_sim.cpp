// The sketch itself on a stub of its board and a simulated chamber, by lines as pressure_sim takes them: rx HEX,
// run MS, and babble BYTES, random ones that come in every millisecond from now on. It ends with exit code 3 where
// the board's watchdog is not fed in time. An argument is the memory's count of power-ons.
#include "Arduino.h"

#include <stdio.h>
#include <stdlib.h>

#include <deque>
#include <iostream>
#include <string>

#include "../pressure_sim/chamber.h"
#include "avr/eeprom.h"
#include "avr/wdt.h"

// What a call takes on an Uno, in microseconds.
constexpr uint64_t kAnalogReadUs = 112;
constexpr uint64_t kByteUs = 20;  // to read it, and its share of decoding a frame
constexpr uint64_t kLoopUs = 4;
constexpr double kStubCountsPerPa = 819 / 25000.0;
constexpr double kStubZeroCounts = 102;

Port Serial;
static Chamber chamber;
static pneutac::Valves valves{0, 0};  // pins without power: the vent is open, see analogWrite
static std::deque<uint8_t> inbox;
static uint64_t now_us = 0, fed_us = 0, watchdog_us = 0, chamber_us = 0;
static unsigned babble = 0, owed_bytes = 0, chance = 1;
static uint32_t memory = 0;
static double peak_pa = 0;

static void work(uint64_t us) {
  now_us += us;
  if (watchdog_us != 0 && now_us - fed_us > watchdog_us) {
    fprintf(stderr, "sketch_sim: the watchdog was not fed\n");
    exit(3);
  }
  for (; chamber_us + 1000 <= now_us; chamber_us += 1000) {
    chamber.step(valves, 1e-3, chamber_us * 1e-6);
    if (chamber.pressure_pa > peak_pa) peak_pa = chamber.pressure_pa;
    owed_bytes += babble;
  }
}

void pinMode(uint8_t, uint8_t) {}
unsigned long millis() { return now_us / 1000; }
unsigned long micros() { return now_us; }

int analogRead(uint8_t) {
  work(kAnalogReadUs);
  const double counts = kStubZeroCounts + chamber.reading_pa * kStubCountsPerPa;
  return counts < 0 ? 0 : counts > 1023 ? 1023 : static_cast<int>(counts);
}

void analogWrite(uint8_t pin, int value) {
  if (pin == 9) {
    valves.inlet = value / 255.0f;
    return;
  }
  valves.vent = 1 - value / 255.0f;
  printf("at %.3f %.1f %d %.4f %.4f\n", now_us * 1e-3, chamber.pressure_pa, chamber.reading_pa, valves.inlet,
         valves.vent);
}

void wdt_enable(int ms) {
  watchdog_us = ms * 1000;
  fed_us = now_us;
}
void wdt_reset() { fed_us = now_us; }
uint32_t eeprom_read_dword(const uint32_t*) { return memory; }
void eeprom_write_dword(uint32_t*, uint32_t value) { memory = value; }

void Port::begin(unsigned long) {}
int Port::available() { return inbox.size() + owed_bytes; }
int Port::availableForWrite() { return 63; }

int Port::read() {
  work(kByteUs);
  if (inbox.empty()) {
    --owed_bytes;
    chance = chance * 1664525u + 1013904223u;
    return chance >> 24;
  }
  const uint8_t byte = inbox.front();
  inbox.pop_front();
  return byte;
}

size_t Port::write(const uint8_t* bytes, size_t size) {
  printf("tx ");
  for (size_t i = 0; i < size; ++i) printf("%02x", bytes[i]);
  printf("\n");
  return size;
}

#include "../pressure_controller/pressure_controller.ino"

int main(int argc, char** argv) {
  if (argc > 1) memory = atol(argv[1]);
  setup();
  std::string verb, argument;
  while (std::cin >> verb >> argument) {
    if (verb == "rx") {
      for (size_t i = 0; i + 1 < argument.size(); i += 2) {
        inbox.push_back(std::stoi(argument.substr(i, 2), nullptr, 16));
      }
    } else if (verb == "babble") {
      babble = std::stoul(argument);
    } else if (verb == "run") {
      for (const uint64_t end_us = now_us + std::stoul(argument) * 1000; now_us < end_us; work(kLoopUs)) loop();
      printf("done %.1f\n", peak_pa);
      fflush(stdout);
    }
  }
}
