// Frames of the pressure controller's serial protocol; docs/reference/pressure_protocol.md describes every byte.
#pragma once
#include <stddef.h>
#include <stdint.h>

namespace pneutac {

constexpr uint8_t kVersion = 2;
constexpr size_t kMaxPayload = 32;
constexpr size_t kMaxWire = 48;  // the longest frame with its delimiters

enum Type : uint8_t {
  kHello = 0x01,
  kSetPoint = 0x02,
  kVent = 0x03,
  kHeartbeat = 0x04,
  kHelloReply = 0x81,
  kStatus = 0x82,
};

enum Flag : uint16_t {
  kInletOpen = 1 << 0,
  kVented = 1 << 1,
  kRefused = 1 << 2,
  kHeartbeatLost = 1 << 3,
  kOverPressure = 1 << 4,
  kSensorFault = 1 << 5,
  kStuckValve = 1 << 6,
  kBurstLine = 1 << 7,
  kTooMuchAir = 1 << 8,
};
constexpr uint16_t kFaults = kOverPressure | kSensorFault | kStuckValve | kBurstLine | kTooMuchAir;

struct Frame {
  uint8_t type;
  uint16_t session;
  uint16_t sequence;
  uint8_t payload[kMaxPayload];
  uint8_t size;  // bytes of payload
};

// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; "123456789" gives 0x29B1.
uint16_t crc16(const uint8_t* bytes, size_t size);

// Numbers go over the wire with the lowest byte first, whatever the processor's own order.
void put16(uint8_t* at, uint16_t value);
void put32(uint8_t* at, uint32_t value);
uint16_t get16(const uint8_t* at);
uint32_t get32(const uint8_t* at);

// True where a comes after b on the circle of 16-bit numbers (RFC 1982).
bool newer(uint16_t a, uint16_t b);

// Writes a frame with a zero before and after it; returns the number of bytes, at most kMaxWire.
size_t writeFrame(const Frame& frame, uint8_t* wire);

// Finds frames in a stream of bytes. Whatever fails a check is dropped and counted.
class FrameReader {
 public:
  // Takes one byte; true where it completes a sound frame.
  bool push(uint8_t byte, Frame& frame);
  uint16_t bad() const { return bad_; }

 private:
  bool decode(Frame& frame) const;
  uint8_t buffer_[kMaxWire];
  size_t size_ = 0;
  uint16_t bad_ = 0;
};

}  // namespace pneutac
