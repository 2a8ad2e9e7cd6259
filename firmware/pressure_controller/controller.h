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
  uint16_t frozen_ms = 60;      // a reading that stays the same for so long while air flows is a fault
  float gain_per_pa = 4e-4f;    // valve drive per error
  float gain_per_pa_s = 8e-4f;  // valve drive per integrated error
};

// Valve openings from 0 to 1. The vent valve must be a normally open one, so that a loss of power vents too.
struct Valves {
  float inlet;
  float vent;
};

class Controller {
 public:
  explicit Controller(const Settings& settings);

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
  void closeLoop(uint32_t dt_ms);
  void checkSensor(uint32_t dt_ms);
  void checkValves(uint32_t dt_ms);
  void startVenting();

  const Settings settings_;
  FrameReader reader_;

  uint16_t session_ = 0;  // 0: no host
  uint16_t last_session_ = 0;
  uint32_t session_ms_ = 0;  // when this session began
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
  float integral_ = 0;
  float drive_ = -1;  // > 0 opens the inlet, < 0 the vent

  uint32_t step_ms_ = 0;
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
