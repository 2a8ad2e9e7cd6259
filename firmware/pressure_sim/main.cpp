// The firmware's own core on a simulated chamber, on a computer.
//
//   pressure_sim --pty LINK [options]   in real time on a pseudo-terminal, to which LINK points
//   pressure_sim [options]              in simulated time, by lines on stdin:
//       rx HEX   bytes from the host          run MS   that many steps of 1 ms
//       see PA   one step with this reading   pass MS  as run, and no word of its steps
//       wait MS  so long without a step, as on a board that stalled
//     and on stdout:
//       tx HEX   bytes to the host            done PEAK_PA     after every run, see and pass: highest so far
//       at MS TRUE_PA READING_PA INLET VENT   after every step; commanded openings
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "chamber.h"

struct Rig {
  Rig(const pneutac::Settings& settings, uint32_t seed) : controller(settings, seed) {}
  pneutac::Controller controller;
  Chamber chamber;
  pneutac::Valves valves{0, 1};
  uint32_t now_ms = 0;
  double peak_pa = 0;

  void step() {
    ++now_ms;
    chamber.step(valves, 1e-3, now_ms * 1e-3);
    if (chamber.pressure_pa > peak_pa) peak_pa = chamber.pressure_pa;
    valves = controller.step(chamber.reading_pa, now_ms);
  }

  void see(int32_t reading_pa) {
    ++now_ms;
    chamber.reading_pa = reading_pa;
    valves = controller.step(reading_pa, now_ms);
  }
};

static void fail(const char* message, const char* what) {
  fprintf(stderr, "pressure_sim: %s %s\n", message, what);
  exit(2);
}

static void printSent(Rig& rig) {
  uint8_t wire[pneutac::kMaxWire];
  while (size_t size = rig.controller.transmit(wire, rig.now_ms)) {
    printf("tx ");
    for (size_t j = 0; j < size; ++j) printf("%02x", wire[j]);
    printf("\n");
  }
}

static void printStep(const Rig& rig) {
  printf("at %u %.1f %d %.4f %.4f\n", rig.now_ms, rig.chamber.pressure_pa, rig.chamber.reading_pa,
         rig.valves.inlet, rig.valves.vent);
}

static int digit(char c) { return c <= '9' ? c - '0' : c - 'a' + 10; }

static void runScript(Rig& rig) {
  char* line = nullptr;
  size_t room = 0;
  while (getline(&line, &room, stdin) > 0) {
    char* argument = strchr(line, ' ');
    if (!argument) fail("not a line of its language:", line);
    *argument++ = 0;
    if (!strcmp(line, "rx")) {
      for (const char* at = argument; at[0] >= '0' && at[1] >= '0'; at += 2) {
        rig.controller.receive(16 * digit(at[0]) + digit(at[1]), rig.now_ms);
      }
      continue;
    }
    const long number = atol(argument);
    if (!strcmp(line, "see")) {
      rig.see(number);
      printSent(rig);
      printStep(rig);
    } else if (!strcmp(line, "run") || !strcmp(line, "pass")) {
      for (long i = 0; i < number; ++i) {
        rig.step();
        printSent(rig);
        if (line[0] == 'r') printStep(rig);
      }
    } else if (!strcmp(line, "wait")) {
      rig.now_ms += number;
    } else {
      fail("not a word of its language:", line);
    }
    printf("done %.1f\n", rig.peak_pa);
    fflush(stdout);
  }
  free(line);
}

static int openTerminal(const char* link) {
  const int host = posix_openpt(O_RDWR | O_NOCTTY);
  if (host < 0 || grantpt(host) || unlockpt(host)) fail("no pseudo-terminal is free for", link);
  const char* name = ptsname(host);
  const int device = open(name, O_RDWR | O_NOCTTY);  // kept open: the host may come and go
  termios raw;
  tcgetattr(device, &raw);
  cfmakeraw(&raw);
  tcsetattr(device, TCSANOW, &raw);
  fcntl(host, F_SETFL, O_NONBLOCK);
  unlink(link);
  if (symlink(name, link)) fail("cannot write", link);
  return host;
}

static double clockMs() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1e3 + now.tv_nsec * 1e-6;
}

static void runTerminal(Rig& rig, const char* link, double speed) {
  const int host = openTerminal(link);
  uint8_t bytes[256], wire[pneutac::kMaxWire];
  double owed_ms = 0;
  for (double last = clockMs();;) {
    pollfd ready{host, POLLIN, 0};
    poll(&ready, 1, 1);
    const ssize_t n = read(host, bytes, sizeof bytes);  // no more before the next step: a host may babble
    for (ssize_t i = 0; i < n; ++i) rig.controller.receive(bytes[i], rig.now_ms);
    const double now = clockMs();
    owed_ms += (now - last) * speed;
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
  double speed = 1, max_kpa = 15, wrong_air = 1, seed = 0;  // of seed 0: by chance
  const struct { const char* name; double* value; } numbers[] = {
      {"--speed", &speed},
      {"--fill-s", &chamber.fill_s},
      {"--vent-s", &chamber.vent_s},
      {"--leak-per-s", &chamber.leak_per_s},
      {"--noise-pa", &chamber.noise_pa},
      {"--fault-at-s", &chamber.faults.start_s},
      {"--stick-inlet", &chamber.faults.inlet},
      {"--stick-vent", &chamber.faults.vent},
      {"--sensor-stuck", &chamber.faults.stuck_pa},
      {"--sensor-offset", &chamber.faults.offset_pa},
      {"--sensor-drift", &chamber.faults.drift_pa_s},
      {"--sensor-gain", &chamber.faults.gain},
      {"--sensor-noise", &chamber.faults.noise_pa},
      {"--max-kpa", &max_kpa},
      {"--wrong-air", &wrong_air},
      {"--seed", &seed},
  };
  const struct { const char* name; bool* on; } switches[] = {
      {"--burst", &chamber.faults.burst},
      {"--freeze-sensor", &chamber.faults.frozen},
      {"--loose-sensor", &chamber.faults.loose},
  };
  for (int i = 1; i < argc; ++i) {
    bool known = !strcmp(argv[i], "--pty");
    if (known && i + 1 < argc) link = argv[++i];
    for (auto& s : switches) {
      if (!strcmp(argv[i], s.name)) known = *s.on = true;
    }
    for (auto& n : numbers) {
      if (known || strcmp(argv[i], n.name) || i + 1 == argc) continue;
      *n.value = atof(argv[++i]);
      known = true;
    }
    if (!known) fail("unknown, or without its value:", argv[i]);
  }
  settings.max_pa = static_cast<int32_t>(max_kpa * 1000);
  settings.cutoff_pa = static_cast<int32_t>(max_kpa * 1100);
  // The rig was measured, rightly or by this share wrong.
  settings.supply_pa = chamber.supply_pa;
  settings.fill_s = chamber.fill_s / wrong_air;
  settings.vent_s = chamber.vent_s;
  settings.leak_per_s = chamber.leak_per_s;
  const uint32_t chance = static_cast<uint32_t>(time(nullptr)) * 1000003u + getpid();
  Rig rig(settings, seed > 0 ? static_cast<uint32_t>(seed) : chance);
  rig.chamber = chamber;
  if (link) runTerminal(rig, link, speed);
  else runScript(rig);
}
