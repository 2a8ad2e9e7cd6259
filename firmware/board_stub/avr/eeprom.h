#pragma once
#include <stdint.h>
uint32_t eeprom_read_dword(const uint32_t* at);
void eeprom_write_dword(uint32_t* at, uint32_t value);
