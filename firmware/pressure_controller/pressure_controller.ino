// Board glue: one proportional inlet valve, one normally open vent valve, one analog gauge sensor.
// Change the pins, the sensor's scale and the valves' curve here; the control is in controller.cpp.
#include "controller.h"
#if defined(__AVR__)
#include <avr/eeprom.h>
#include <avr/wdt.h>
#endif

const int kInletPin = 9;   // PWM to the inlet valve's driver
const int kVentPin = 10;   // PWM to the vent valve's driver; without power this valve is open
const int kSensorPin = A0;
const int kSecondSensorPin = -1;  // of a second sensor of the same kind, such as A1; -1: there is none

// A sensor of 0.5 ... 4.5 V for 0 ... 25 kPa on a 10-bit converter with 5 V.
const long kZeroCounts = 102;
const long kSpanCounts = 819;
const long kSpanPa = 25000;
const int kReadings = 4;  // summed: finer than one count
const int kBytesPerStep = 32;  // a host that babbles must not keep the control waiting

uint32_t last_ms = 0;
uint8_t wire[pneutac::kMaxWire];

int32_t readSensor(int pin) {
  long sum = 0;
  for (int i = 0; i < kReadings; ++i) sum += analogRead(pin);
  return (sum - kReadings * kZeroCounts) * kSpanPa / (kReadings * kSpanCounts);
}

// With two sensors the higher one counts, so that none of them alone can fill the chamber further.
int32_t readPressure() {
  const int32_t first = readSensor(kSensorPin);
  if (kSecondSensorPin < 0) return first;
  const int32_t second = readSensor(kSecondSensorPin);
  return second > first ? second : first;
}

// Another number at every power-on: how often there was one, and on boards without AVR's memory the inputs' noise.
uint32_t powerOns() {
#if defined(__AVR__)
  uint32_t* const at = 0;
  const uint32_t count = eeprom_read_dword(at) + 1;
  eeprom_write_dword(at, count);
  return count;
#else
  uint32_t noise = micros();
  for (int i = 0; i < 64; ++i) noise = noise * 31 + analogRead(kSensorPin);
  return noise;
#endif
}

// A board that hangs restarts, and its valves are without power meanwhile: the vent opens.
void startWatchdog() {
#if defined(__AVR__)
  wdt_enable(WDTO_60MS);
#endif
}

void feedWatchdog() {
#if defined(__AVR__)
  wdt_reset();
#endif
}

// Made at the first call, in setup: before it a board's inputs cannot be read.
pneutac::Controller& controller() {
  static pneutac::Controller one{pneutac::Settings{}, powerOns()};
  return one;
}

// Openings from 0 to 1 are shares of the greatest flow: where yours begins to open at a third of the power, say so here.
void openValves(const pneutac::Valves& valves) {
  analogWrite(kInletPin, static_cast<int>(255 * valves.inlet));
  analogWrite(kVentPin, static_cast<int>(255 * (1 - valves.vent)));  // power closes it
}

void setup() {
  pinMode(kInletPin, OUTPUT);
  pinMode(kVentPin, OUTPUT);
  openValves(pneutac::Valves{0, 1});
  Serial.begin(115200);
  controller();
  startWatchdog();
}

void loop() {
  for (int i = 0; i < kBytesPerStep && Serial.available() > 0; ++i) {
    controller().receive(static_cast<uint8_t>(Serial.read()), millis());
  }
  const uint32_t now = millis();
  if (now == last_ms) return;
  last_ms = now;
  feedWatchdog();
  openValves(controller().step(readPressure(), now));
  // A full buffer would block the loop, and with it the control.
  if (Serial.availableForWrite() >= static_cast<int>(pneutac::kMaxWire)) {
    const size_t size = controller().transmit(wire, now);
    if (size > 0) Serial.write(wire, size);
  }
}
