/* The board of a host build: a struct that a program sets and reads. Tests and the twin drive it through cffi. */
#include "board_host.h"

#include <string.h>

const char board_name[] = "host";
static struct host *host;

void host_select(struct host *h)
{
    host = h;
}

uint32_t board_now_us(void)
{
    const uint32_t now = host->now_us;

    host->now_us += host->call_us;
    return now;
}

bool board_uart_read(uint8_t *byte)
{
    if (host->received == host->arrived) {
        return false;
    }
    *byte = host->to_robot[host->received];
    host->received++;
    return true;
}

bool board_uart_write(const uint8_t *bytes, uint8_t length)
{
    if (host->sent + length > HOST_LINE_BYTES) {
        return false;
    }
    memcpy(&host->to_host[host->sent], bytes, length);
    host->sent += length;
    return true;
}

int32_t board_encoder(enum board_side side)
{
    return host->counts[side];
}

void board_pwm(enum board_side side, int16_t duty)
{
    host->duty[side] = duty;
}

bool board_eeprom_ready(void)
{
    if (host->writing > 0u) {
        host->writing--;
        return false;
    }
    return true;
}

uint8_t board_eeprom_read(uint8_t address)
{
    return host->eeprom[address];
}

void board_eeprom_write(uint8_t address, uint8_t value)
{
    host->writing = HOST_WRITE_LOOPS;
    if (host->writes_left > 0) {
        host->writes_left--;
        host->eeprom[address] = value | host->worn[address];
    }
}

void board_watchdog_kick(void)
{
    host->kicks++;
}

uint8_t board_reset_cause(void)
{
    return host->reset;
}

uint8_t board_faults(void)
{
    return host->faults;
}

uint16_t board_battery_mv(void)
{
    return host->battery_mv;
}

int16_t board_current_ma(enum board_side side)
{
    return host->current_ma[side];
}
