// The firmware's own core on a simulated chamber, on a computer.
//
//   pressure_sim --pty LINK [options]   in real time on a pseudo-terminal, to which LINK points
//   pressure_sim [options]              in simulated time, by lines on stdin:
//       rx HEX   bytes from the host          run MS   that many steps of 1 ms
//     and on stdout:
//       tx HEX   bytes to the host            done     after every run
//       at MS TRUE_PA READING_PA INLET VENT   after every step; commanded openings
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <chrono>
#include <iostream>
#include <string>

#include "chamber.h"

struct Rig {
  explicit Rig(const pneutac::Settings& settings) : controller(settings) {}
  pneutac::Controller controller;
  Chamber chamber;
  pneutac::Valves valves{0, 1};
  uint32_t now_ms = 0;

  void step() {
    ++now_ms;
    chamber.step(valves, 1e-3, now_ms * 1e-3);
    valves = controller.step(chamber.reading_pa, now_ms);
  }
};

static void fail(const std::string& message) {
  fprintf(stderr, "pressure_sim: %s\n", message.c_str());
  exit(2);
}

static void runScript(Rig& rig) {
  uint8_t wire[pneutac::kMaxWire];
  std::string verb, argument;
  while (std::cin >> verb >> argument) {
    if (verb == "rx") {
      for (size_t i = 0; i + 1 < argument.size(); i += 2) {
        rig.controller.receive(std::stoi(argument.substr(i, 2), nullptr, 16), rig.now_ms);
      }
    } else if (verb == "run") {
      for (long i = std::stol(argument); i > 0; --i) {
        rig.step();
        while (size_t size = rig.controller.transmit(wire, rig.now_ms)) {
          printf("tx ");
          for (size_t j = 0; j < size; ++j) printf("%02x", wire[j]);
          printf("\n");
        }
        printf("at %u %.1f %d %.4f %.4f\n", rig.now_ms, rig.chamber.pressure_pa, rig.chamber.reading_pa,
               rig.valves.inlet, rig.valves.vent);
      }
      printf("done\n");
      fflush(stdout);
    } else {
      fail("unknown line '" + verb + "'");
    }
  }
}

static int openTerminal(const char* link) {
  const int host = posix_openpt(O_RDWR | O_NOCTTY);
  if (host < 0 || grantpt(host) || unlockpt(host)) fail("no pseudo-terminal is free");
  const char* name = ptsname(host);
  const int device = open(name, O_RDWR | O_NOCTTY);  // kept open: the host may come and go
  termios raw;
  tcgetattr(device, &raw);
  cfmakeraw(&raw);
  tcsetattr(device, TCSANOW, &raw);
  fcntl(host, F_SETFL, O_NONBLOCK);
  unlink(link);
  if (symlink(name, link)) fail(std::string("cannot write ") + link);
  return host;
}

static void runTerminal(Rig& rig, const char* link, double speed) {
  using Clock = std::chrono::steady_clock;
  const int host = openTerminal(link);
  uint8_t bytes[256], wire[pneutac::kMaxWire];
  double owed_ms = 0;
  for (auto last = Clock::now();;) {
    pollfd ready{host, POLLIN, 0};
    poll(&ready, 1, 1);
    ssize_t n;
    while ((n = read(host, bytes, sizeof bytes)) > 0) {
      for (ssize_t i = 0; i < n; ++i) rig.controller.receive(bytes[i], rig.now_ms);
    }
    const auto now = Clock::now();
    owed_ms += std::chrono::duration<double, std::milli>(now - last).count() * speed;
    last = now;
    if (owed_ms > 5) owed_ms = 5;  // a board never sleeps; where this computer did, time stood still
    for (; owed_ms >= 1; owed_ms -= 1) {
      rig.step();
      while (size_t size = rig.controller.transmit(wire, rig.now_ms)) {
        if (write(host, wire, size) < 0) break;  // nobody reads
      }
    }
  }
}

int main(int argc, char** argv) {
  pneutac::Settings settings;
  Chamber chamber;
  const char* link = nullptr;
  double speed = 1;
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    if (name == "--burst") {
      chamber.faults.burst = true;
      continue;
    }
    if (name == "--freeze-sensor") {
      chamber.faults.frozen = true;
      continue;
    }
    if (name == "--loose-sensor") {
      chamber.faults.loose = true;
      continue;
    }
    if (++i == argc) fail(name + " is unknown or needs a value");
    const double value = atof(argv[i]);
    if (name == "--pty") link = argv[i];
    else if (name == "--speed") speed = value;
    else if (name == "--max-kpa") settings.max_pa = value * 1000, settings.cutoff_pa = value * 1100;
    else if (name == "--fill-s") chamber.fill_s = value;
    else if (name == "--vent-s") chamber.vent_s = value;
    else if (name == "--leak-per-s") chamber.leak_per_s = value;
    else if (name == "--noise-pa") chamber.noise_pa = value;
    else if (name == "--stick-inlet") chamber.faults.inlet = value;
    else if (name == "--stick-vent") chamber.faults.vent = value;
    else if (name == "--fault-at-s") chamber.faults.start_s = value;
    else fail("unknown option " + name);
  }
  Rig rig(settings);
  rig.chamber = chamber;
  if (link) runTerminal(rig, link, speed);
  else runScript(rig);
}
