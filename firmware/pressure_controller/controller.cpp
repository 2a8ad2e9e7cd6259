#include "controller.h"

namespace pneutac {

constexpr uint32_t kStuckMs = 500;     // fully driven, and the pressure does not move
constexpr uint32_t kBurstMs = 30;      // falling while the inlet is open
constexpr float kFollowShare = 0.07f;  // of max_pa: error above which the pressure "does not follow"
constexpr float kBurstShare = 0.10f;   // of max_pa: fall that is no noise
constexpr float kSmoothS = 0.05f;
constexpr float kSettledShare = 0.07f;  // of max_pa in a second: slower is settled
constexpr float kIntegralMost = 0.25f;  // of the drive: what a leak asks for
constexpr float kAirShare = 0.98f;      // of cutoff_pa: more air than that is let out, whatever is read
constexpr float kRiseShare = 0.25f;     // of the rise by the air account: a reading that rises less is none
constexpr float kRiseS = 0.5f;          // a slower rise may be a leak that is made up for
constexpr float kDriven = 0.3f;
constexpr float kFull = 0.99f;

static float clamp(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

// A number that looks like any other (the finaliser of MurmurHash3), and is never 0.
static uint32_t scrambled(uint32_t x) {
  x = (x ^ (x >> 16)) * 0x85EBCA6Bu;
  x = (x ^ (x >> 13)) * 0xC2B2AE35u;
  return (x ^ (x >> 16)) | 1;
}

Controller::Controller(const Settings& settings, uint32_t seed)
    : settings_(settings), nonce_(scrambled(seed)) {}

void Controller::receive(uint8_t byte, uint32_t now_ms) {
  Frame frame;
  if (reader_.push(byte, frame)) handle(frame, now_ms);
}

void Controller::handle(const Frame& frame, uint32_t now_ms) {
  if (frame.type == kHello) {
    handleHello(frame, now_ms);
  } else if (session_ == 0 || frame.session != session_) {
    ++repeated_;  // of an earlier connection
  } else if (frame.type == kHeartbeat && frame.size == 0) {
    if (newer(frame.sequence, beat_)) {
      beat_ = frame.sequence;
      beat_ms_ = now_ms;
    } else {
      ++repeated_;
    }
  } else if ((frame.type == kSetPoint && frame.size == 4) || (frame.type == kVent && frame.size == 0)) {
    handleCommand(frame);
  }
}

// A hello with any other nonce is a question, or of another time: it is answered and changes nothing.
void Controller::handleHello(const Frame& frame, uint32_t now_ms) {
  if (frame.size == 0 || frame.session == 0) return;
  reply_due_ = true;  // also to another version, so that the host can name both
  if (frame.payload[0] != kVersion || frame.size != 6 || get32(frame.payload + 2) != nonce_) return;
  startVenting();
  nonce_ = scrambled(nonce_ + now_ms);
  session_ = frame.session;
  command_ = beat_ = applied_ = repeated_ = 0;
  beat_ms_ = now_ms;
  if (frame.payload[1]) latched_ = 0;
  else latched_ &= kFaults;
  stuck_ms_ = burst_ms_ = frozen_ms_ = owed_ms_ = 0;
}

void Controller::handleCommand(const Frame& frame) {
  if (!newer(frame.sequence, command_)) {
    ++repeated_;
    return;
  }
  command_ = frame.sequence;
  if (frame.type == kVent) {
    startVenting();
    return;
  }
  const int32_t target = static_cast<int32_t>(get32(frame.payload));
  if ((latched_ & (kFaults | kHeartbeatLost)) || target < 0 || target > settings_.max_pa) {
    latched_ |= kRefused;
    return;
  }
  latched_ &= ~kRefused;
  if (!controlling_) {
    ramp_pa_ = clamp(measured_pa_, 0, settings_.max_pa);
    integral_ = 0;
  }
  controlling_ = true;
  target_pa_ = target;
  ++applied_;
}

void Controller::startVenting() {
  controlling_ = false;
  target_pa_ = 0;
  drive_ = -1;
}

Valves Controller::step(int32_t measured_pa, uint32_t now_ms) {
  const uint32_t dt_ms = now_ms - step_ms_;
  step_ms_ = now_ms;
  measured_pa_ = measured_pa;
  countAir(dt_ms);
  if (session_ != 0 && now_ms - beat_ms_ >= settings_.heartbeat_ms) latched_ |= kHeartbeatLost;
  if (measured_pa > settings_.cutoff_pa) latched_ |= kOverPressure;
  if (controlling_) closeLoop(dt_ms);
  checkSensor(dt_ms);
  checkRise(dt_ms);
  checkValves(dt_ms);
  if (latched_ & (kFaults | kHeartbeatLost)) startVenting();
  return Valves{drive_ > 0 ? drive_ : 0, drive_ < 0 ? -drive_ : 0};
}

// What the valves did since the last step. A valve lags its command, and so does the true pressure this account.
void Controller::countAir(uint32_t dt_ms) {
  const float dt = dt_ms * 1e-3f;
  if (drive_ > 0) {
    air_pa_ += (settings_.supply_pa - air_pa_) * clamp(drive_ * dt / settings_.fill_s, 0, 1);
  } else {
    air_pa_ -= air_pa_ * clamp(-drive_ * dt / settings_.vent_s, 0, 1);
  }
  air_pa_ -= air_pa_ * clamp(settings_.leak_per_s * dt, 0, 1);
  const float share = clamp(dt / kSmoothS, 0, 1);
  smooth_pa_ += (measured_pa_ - smooth_pa_) * share;
  smooth_air_pa_ += (air_pa_ - smooth_air_pa_) * share;
  if (air_pa_ > kAirShare * settings_.cutoff_pa) latched_ |= kTooMuchAir;
}

// PI control of the pressure towards a target that moves no faster than rate_pa_s.
void Controller::closeLoop(uint32_t dt_ms) {
  const float dt = dt_ms * 1e-3f;
  const float stride = settings_.rate_pa_s * dt;
  const float left = target_pa_ - ramp_pa_;
  ramp_pa_ += clamp(left, -stride, stride);
  const float error = ramp_pa_ - measured_pa_;
  const float rate = (measured_pa_ - smooth_pa_) / kSmoothS;
  const float settled = kSettledShare * settings_.max_pa;
  // The integral is for a leak. Built up while the pressure is still on its way, it would overshoot at the end.
  if (ramp_pa_ == target_pa_ && rate > -settled && rate < settled) {
    integral_ = clamp(integral_ + settings_.gain_per_pa_s * error * dt, -kIntegralMost, kIntegralMost);
  }
  drive_ = clamp(settings_.gain_per_pa * error + integral_, -1, 1);
}

void Controller::checkSensor(uint32_t dt_ms) {
  const int32_t max = settings_.max_pa;
  if (measured_pa_ < settings_.sensor_low_pa || measured_pa_ / 4 > max) latched_ |= kSensorFault;
  // A live reading has noise; one that stays the same to the last bit while air flows is no reading.
  const bool empty = drive_ < 0 && measured_pa_ < kFollowShare * max;
  const bool driven = drive_ > kDriven || drive_ < -kDriven;
  frozen_ms_ = driven && !empty && measured_pa_ == frozen_pa_ ? frozen_ms_ + dt_ms : 0;
  frozen_pa_ = measured_pa_;
  if (frozen_ms_ >= settings_.frozen_ms) latched_ |= kSensorFault;
}

// The reading must rise with the air: one that has noise and stays is no reading either.
void Controller::checkRise(uint32_t dt_ms) {
  const float air = smooth_air_pa_ - rise_air_pa_;
  const bool rises = air > kFollowShare * settings_.max_pa;
  const bool owed = rises && smooth_pa_ - rise_pa_ < kRiseShare * air;
  owed_ms_ = owed ? owed_ms_ + dt_ms : 0;
  rise_s_ += dt_ms * 1e-3f;
  if (!owed && (rises || air < 0 || rise_s_ >= kRiseS)) {
    rise_s_ = 0;
    rise_air_pa_ = smooth_air_pa_;
    rise_pa_ = smooth_pa_;
  }
  if (owed_ms_ >= settings_.frozen_ms) latched_ |= kStuckValve;
}

void Controller::checkValves(uint32_t dt_ms) {
  const float error = (controlling_ ? ramp_pa_ : 0) - measured_pa_;
  const float tolerance = kFollowShare * settings_.max_pa;
  const bool stuck = (drive_ > kFull && error > tolerance) || (drive_ < -kFull && error < -tolerance);
  const float moved = drive_ > 0 ? float(measured_pa_) - stuck_pa_ : float(stuck_pa_) - measured_pa_;
  const bool moves = moved > tolerance / 2;
  stuck_ms_ = stuck && !moves ? stuck_ms_ + dt_ms : 0;
  if (!stuck || moves) stuck_pa_ = measured_pa_;
  if (stuck_ms_ >= kStuckMs) latched_ |= kStuckValve;

  if (drive_ <= 0 || measured_pa_ > peak_pa_) peak_pa_ = measured_pa_;
  const bool falling = drive_ > kDriven && float(peak_pa_) - measured_pa_ > kBurstShare * settings_.max_pa;
  burst_ms_ = falling ? burst_ms_ + dt_ms : 0;
  if (burst_ms_ >= kBurstMs) latched_ |= kBurstLine;
}

size_t Controller::transmit(uint8_t* wire, uint32_t now_ms) {
  Frame frame;
  frame.session = session_;
  if (reply_due_) {
    reply_due_ = false;
    frame.type = kHelloReply;
    frame.sequence = 0;
    frame.size = 17;
    frame.payload[0] = kVersion;
    put32(frame.payload + 1, settings_.max_pa);
    put32(frame.payload + 5, settings_.rate_pa_s);
    put16(frame.payload + 9, settings_.heartbeat_ms);
    put16(frame.payload + 11, settings_.status_ms);
    put32(frame.payload + 13, nonce_);
    return writeFrame(frame, wire);
  }
  if (now_ms - status_ms_ < settings_.status_ms) return 0;
  status_ms_ = now_ms;
  frame.type = kStatus;
  frame.sequence = ++status_sequence_;
  frame.size = 20;
  uint16_t flags = latched_;
  if (drive_ > 0) flags |= kInletOpen;
  if (!controlling_) flags |= kVented;
  put32(frame.payload, measured_pa_);
  put32(frame.payload + 4, target_pa_);
  put16(frame.payload + 8, flags);
  put16(frame.payload + 10, beat_);
  put16(frame.payload + 12, command_);
  put16(frame.payload + 14, applied_);
  put16(frame.payload + 16, repeated_);
  put16(frame.payload + 18, reader_.bad());
  return writeFrame(frame, wire);
}

}  // namespace pneutac
