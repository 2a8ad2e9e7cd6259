// A finger's chamber on two valves, for running the firmware without a rig.
#pragma once
#include <math.h>
#include <stdint.h>

#include "../pressure_controller/controller.h"

struct Faults {
  double start_s = 0;       // when the faults below begin
  double inlet = -1;        // opening at which the inlet valve sticks; < 0: it moves
  double vent = -1;         // the same of the vent valve
  bool burst = false;       // the line comes off
  bool frozen = false;      // the sensor repeats its last reading
  bool loose = false;       // the sensor's wire is off: 0 V, the lowest that the converter shows
  double stuck_pa = NAN;    // the sensor reads this, with its noise
  double offset_pa = 0;     // it reads so much more
  double drift_pa_s = 0;    // the same, growing
  double gain = 1;          // it reads so many times the pressure
  double noise_pa = 0;      // added to its noise
};

// First-order filling from a regulated supply, first-order venting, a leak, and valves that take a moment.
class Chamber {
 public:
  double supply_pa = 40000;
  double fill_s = 0.25;  // time constant with the inlet fully open
  double vent_s = 0.10;
  double leak_per_s = 0;
  double noise_pa = 20;
  Faults faults;

  void step(const pneutac::Valves& command, double dt, double time_s) {
    const bool broken = time_s >= faults.start_s;
    const double moved = dt / kValveS;
    inlet += moved * ((broken && faults.inlet >= 0 ? faults.inlet : command.inlet) - inlet);
    vent += moved * ((broken && faults.vent >= 0 ? faults.vent : command.vent) - vent);
    double rate = inlet * (supply_pa - pressure_pa) / fill_s - vent * pressure_pa / vent_s;
    rate -= leak_per_s * pressure_pa;
    if (broken && faults.burst) rate -= pressure_pa / kBurstS;
    pressure_pa += rate * dt;
    if (broken && faults.frozen) return;
    reading_pa = static_cast<int32_t>(lrint(broken ? brokenReading(time_s) : pressure_pa + noise_pa * noise()));
  }

  double pressure_pa = 0;
  double inlet = 0;
  double vent = 1;
  int32_t reading_pa = 0;

 private:
  double brokenReading(double time_s) {
    double pa = isnan(faults.stuck_pa) ? faults.gain * pressure_pa : faults.stuck_pa;
    pa += faults.offset_pa + faults.drift_pa_s * (time_s - faults.start_s);
    if (faults.loose) pa = kLoosePa;
    pa += (noise_pa + faults.noise_pa) * noise();
    return pa < kLoosePa ? kLoosePa : pa > kMostPa ? kMostPa : pa;
  }

  static constexpr double kValveS = 0.005;
  static constexpr double kBurstS = 0.010;
  // The sketch's sensor at 0 and 5 V.
  static constexpr double kLoosePa = -3113;
  static constexpr double kMostPa = 28114;

  double noise() {  // uniform in -1 ... 1, the same in every run
    state_ = state_ * 1664525u + 1013904223u;
    return (state_ >> 8) * (2.0 / 16777216.0) - 1.0;
  }
  uint32_t state_ = 1;
};
