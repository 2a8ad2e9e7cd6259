// Pressure control and its safety, free of any board: bytes and a measured pressure in, valves and bytes out.
#pragma once
#include "protocol.h"

namespace pneutac {

// What a rig is built for. Pressures are gauge.
struct Settings {
  int32_t max_pa = 15000;       // the highest set-point that is accepted
  int32_t cutoff_pa = 16500;    // above this the chamber is vented at once
  uint32_t rate_pa_s = 50000;   // the target moves no faster
  int32_t sensor_low_pa = -1500;  // below this reads only a loose wire of a sensor whose zero is above 0 V
  uint16_t heartbeat_ms = 80;   // without a heartbeat for this long the chamber is vented
  uint16_t status_ms = 10;      // time between two status frames
  uint16_t frozen_ms = 60;      // a reading that does not answer to the air for so long is a fault
  float gain_per_pa = 4e-4f;    // valve drive per error
  float gain_per_pa_s = 8e-4f;  // valve drive per integrated error
  // What the air account counts with, measured on the rig; where in doubt, what gives more air.
  float supply_pa = 40000;  // in front of the inlet valve
  float fill_s = 0.25f;     // time constant of filling through the open inlet
  float vent_s = 0.10f;     // time constant of emptying through the open vent
  float leak_per_s = 0;     // share of its pressure that the chamber loses by itself; the least that was seen
};

// Valve openings from 0 to 1. The vent valve must be a normally open one, so that a loss of power vents too.
struct Valves {
  float inlet;
  float vent;
};

class Controller {
 public:
  // seed: another number at every power-on, so that no nonce comes twice.
  Controller(const Settings& settings, uint32_t seed);

  // One byte from the host.
  void receive(uint8_t byte, uint32_t now_ms);

  // One step of control with the newest reading; call it at least every 5 ms.
  Valves step(int32_t measured_pa, uint32_t now_ms);

  // Puts the next frame for the host into wire (kMaxWire bytes); returns its size, 0 if there is none.
  size_t transmit(uint8_t* wire, uint32_t now_ms);

 private:
  void handle(const Frame& frame, uint32_t now_ms);
  void handleHello(const Frame& frame, uint32_t now_ms);
  void handleCommand(const Frame& frame);
  void countAir(uint32_t dt_ms);
  void closeLoop(uint32_t dt_ms);
  void checkSensor(uint32_t dt_ms);
  void checkRise(uint32_t dt_ms);
  void checkValves(uint32_t dt_ms);
  void startVenting();

  const Settings settings_;
  FrameReader reader_;

  uint16_t session_ = 0;  // 0: no host
  uint32_t nonce_;        // opens the next session; then never again
  uint16_t command_ = 0;  // sequence number of the newest set-point or vent
  uint16_t beat_ = 0;     // sequence number of the newest heartbeat
  uint32_t beat_ms_ = 0;
  uint16_t applied_ = 0;   // set-points that took effect
  uint16_t repeated_ = 0;  // frames dropped as old or double
  uint16_t latched_ = 0;   // kRefused, kHeartbeatLost and faults

  bool controlling_ = false;  // otherwise vented
  int32_t measured_pa_ = 0;
  int32_t target_pa_ = 0;
  float ramp_pa_ = 0;  // the target, limited in rate
  float smooth_pa_ = 0;  // the reading behind a low-pass
  float smooth_air_pa_ = 0;  // the air account behind the same
  float integral_ = 0;
  float drive_ = -1;  // > 0 opens the inlet, < 0 the vent

  uint32_t step_ms_ = 0;
  float air_pa_ = 0;  // the pressure that all air let in and out makes, whatever the sensor reads
  float rise_air_pa_ = 0, rise_pa_ = 0;  // both where the present rise began
  float rise_s_ = 0;       // since then
  uint32_t owed_ms_ = 0;   // for so long the reading has not risen as the air did
  int32_t peak_pa_ = 0;
  int32_t frozen_pa_ = 0;
  uint32_t frozen_ms_ = 0;
  uint32_t stuck_ms_ = 0;
  int32_t stuck_pa_ = 0;
  uint32_t burst_ms_ = 0;

  bool reply_due_ = false;
  uint16_t status_sequence_ = 0;
  uint32_t status_ms_ = 0;
};

}  // namespace pneutac
