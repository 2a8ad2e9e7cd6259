#include "protocol.h"

#include <string.h>

namespace pneutac {

constexpr size_t kHeader = 5;
constexpr size_t kCrc = 2;

uint16_t crc16(const uint8_t* bytes, size_t size) {
  uint16_t crc = 0xFFFF;
  for (size_t i = 0; i < size; ++i) {
    crc ^= static_cast<uint16_t>(bytes[i]) << 8;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000) ? (crc << 1) ^ 0x1021 : crc << 1;
  }
  return crc;
}

void put16(uint8_t* at, uint16_t value) {
  at[0] = value & 0xFF;
  at[1] = value >> 8;
}

void put32(uint8_t* at, uint32_t value) {
  put16(at, value & 0xFFFF);
  put16(at + 2, value >> 16);
}

uint16_t get16(const uint8_t* at) { return at[0] | static_cast<uint16_t>(at[1]) << 8; }

uint32_t get32(const uint8_t* at) { return get16(at) | static_cast<uint32_t>(get16(at + 2)) << 16; }

bool newer(uint16_t a, uint16_t b) {
  const uint16_t ahead = a - b;
  return ahead != 0 && ahead < 0x8000;
}

size_t writeFrame(const Frame& frame, uint8_t* wire) {
  uint8_t plain[kHeader + kMaxPayload + kCrc];
  plain[0] = frame.type;
  put16(plain + 1, frame.session);
  put16(plain + 3, frame.sequence);
  memcpy(plain + kHeader, frame.payload, frame.size);
  size_t size = kHeader + frame.size;
  put16(plain + size, crc16(plain, size));
  size += kCrc;

  // COBS: every zero becomes the distance to the next one, so that a zero on the wire only ends a frame.
  size_t n = 0;
  wire[n++] = 0;
  size_t code_at = n++;
  uint8_t code = 1;
  for (size_t i = 0; i < size; ++i) {
    if (plain[i] == 0) {
      wire[code_at] = code;
      code_at = n++;
      code = 1;
    } else {
      wire[n++] = plain[i];
      ++code;
    }
  }
  wire[code_at] = code;
  wire[n++] = 0;
  return n;
}

bool FrameReader::decode(Frame& frame) const {
  uint8_t plain[kMaxWire];
  size_t n = 0;
  for (size_t i = 0; i < size_;) {
    const uint8_t code = buffer_[i];
    if (i + code > size_) return false;
    for (uint8_t j = 1; j < code; ++j) plain[n++] = buffer_[i + j];
    i += code;
    if (i < size_) plain[n++] = 0;
  }
  if (n < kHeader + kCrc || n > kHeader + kMaxPayload + kCrc) return false;
  if (crc16(plain, n - kCrc) != get16(plain + n - kCrc)) return false;
  frame.type = plain[0];
  frame.session = get16(plain + 1);
  frame.sequence = get16(plain + 3);
  frame.size = static_cast<uint8_t>(n - kHeader - kCrc);
  memcpy(frame.payload, plain + kHeader, frame.size);
  return true;
}

bool FrameReader::push(uint8_t byte, Frame& frame) {
  if (byte != 0) {
    if (size_ < kMaxWire) buffer_[size_++] = byte;  // what is cut stays too long to be a frame
    return false;
  }
  const bool empty = size_ == 0;
  const bool sound = !empty && decode(frame);
  if (!empty && !sound) ++bad_;
  size_ = 0;
  return sound;
}

}  // namespace pneutac
