// Board glue: one proportional inlet valve, one normally open vent valve, one analog gauge sensor.
// Change the pins and the sensor's scale here; the control is in controller.cpp.
#include "controller.h"

const int kInletPin = 9;   // PWM to the inlet valve's driver
const int kVentPin = 10;   // PWM to the vent valve's driver; without power this valve is open
const int kSensorPin = A0;

// A sensor of 0.5 ... 4.5 V for 0 ... 25 kPa on a 10-bit converter with 5 V.
const long kZeroCounts = 102;
const long kSpanCounts = 819;
const long kSpanPa = 25000;
const int kReadings = 4;  // summed: finer than one count

pneutac::Controller controller{pneutac::Settings{}};
uint32_t last_ms = 0;
uint8_t wire[pneutac::kMaxWire];

int32_t readPressure() {
  long sum = 0;
  for (int i = 0; i < kReadings; ++i) sum += analogRead(kSensorPin);
  return (sum - kReadings * kZeroCounts) * kSpanPa / (kReadings * kSpanCounts);
}

void openValves(const pneutac::Valves& valves) {
  analogWrite(kInletPin, static_cast<int>(255 * valves.inlet));
  analogWrite(kVentPin, static_cast<int>(255 * (1 - valves.vent)));  // power closes it
}

void setup() {
  pinMode(kInletPin, OUTPUT);
  pinMode(kVentPin, OUTPUT);
  openValves(pneutac::Valves{0, 1});
  Serial.begin(115200);
}

void loop() {
  while (Serial.available() > 0) controller.receive(static_cast<uint8_t>(Serial.read()), millis());
  const uint32_t now = millis();
  if (now == last_ms) return;
  last_ms = now;
  openValves(controller.step(readPressure(), now));
  // A full buffer would block the loop, and with it the control.
  if (Serial.availableForWrite() >= static_cast<int>(pneutac::kMaxWire)) {
    const size_t size = controller.transmit(wire, now);
    if (size > 0) Serial.write(wire, size);
  }
}
