#pragma once
constexpr int WDTO_60MS = 60;
void wdt_enable(int ms);
void wdt_reset();
