/* ESP32 with an L298 and two quadrature encoders (README.md): its line is the UART of the USB port, or UDP over Wi-Fi.
 *
 * For ESP-IDF 5.3 or newer; esp32/ is its project. The robot has a task on the last core, with a loop a millisecond;
 * Wi-Fi has the first one. Nothing but the latch is written to flash.
 */
#include <string.h>

#include "driver/gpio.h"
#include "driver/ledc.h"
#include "driver/pulse_cnt.h"
#include "driver/uart.h"
#include "esp_attr.h"
#include "esp_event.h"
#include "esp_netif.h"
#include "esp_partition.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "esp_wifi.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "sdkconfig.h"

#include "../config.h"
#include "../flash_log.h"
#include "../robot.h"
#include "../udp.h"

const char board_name[] = "esp32";

#define ENABLE GPIO_NUM_27
enum { LEFT_FORWARD = 25, LEFT_BACKWARD = 26, RIGHT_FORWARD = 32, RIGHT_BACKWARD = 33 }; /* GPIOs */
enum { LEFT_A = 18, LEFT_B = 19, RIGHT_A = 21, RIGHT_B = 22 };
enum { PWM_HZ = 20000, WATCHDOG_MS = 120, STACK_BYTES = 6144, PRIORITY = 20, GLITCH_NS = 1000, LINE_BUFFER = 512 };

/* --- Motors: one input of the L298 gets PWM, the other one is low. --- */

static void start_motors(void)
{
    static const int pins[] = {LEFT_FORWARD, LEFT_BACKWARD, RIGHT_FORWARD, RIGHT_BACKWARD}; /* of the channels 0 to 3 */
    const ledc_timer_config_t timer = {.speed_mode = LEDC_LOW_SPEED_MODE, .duty_resolution = LEDC_TIMER_10_BIT,
        .timer_num = LEDC_TIMER_0, .freq_hz = PWM_HZ, .clk_cfg = LEDC_AUTO_CLK};

    ESP_ERROR_CHECK(gpio_reset_pin(ENABLE));
    ESP_ERROR_CHECK(gpio_set_level(ENABLE, 0));
    ESP_ERROR_CHECK(gpio_set_direction(ENABLE, GPIO_MODE_OUTPUT));
    ESP_ERROR_CHECK(ledc_timer_config(&timer));
    for (int k = 0; k < 4; k++) {
        const ledc_channel_config_t channel = {.gpio_num = pins[k], .speed_mode = LEDC_LOW_SPEED_MODE,
            .channel = (ledc_channel_t)k, .timer_sel = LEDC_TIMER_0, .duty = 0, .hpoint = 0};
        ESP_ERROR_CHECK(ledc_channel_config(&channel));
    }
}

static void set_duty(int channel, uint32_t duty)
{
    (void)ledc_set_duty(LEDC_LOW_SPEED_MODE, (ledc_channel_t)channel, duty);
    (void)ledc_update_duty(LEDC_LOW_SPEED_MODE, (ledc_channel_t)channel);
}

void board_pwm(enum board_side side, int16_t duty)
{
    const int forward = side == BOARD_LEFT ? 0 : 2;

    set_duty(duty > 0 ? forward + 1 : forward, 0u);
    set_duty(duty > 0 ? forward : forward + 1, (uint32_t)(duty > 0 ? duty : -duty));
}

/* --- Encoders: the counter begins anew at 0 where it reaches a limit; it is read long before it gets half as far. --- */

enum { LIMIT = INT16_MAX };
static pcnt_unit_handle_t units[2];

static void start_encoder(enum board_side side, int a, int b)
{
    const pcnt_unit_config_t unit = {.low_limit = -LIMIT, .high_limit = LIMIT};
    const pcnt_glitch_filter_config_t filter = {.max_glitch_ns = GLITCH_NS};
    const pcnt_chan_config_t of_a = {.edge_gpio_num = a, .level_gpio_num = b};
    const pcnt_chan_config_t of_b = {.edge_gpio_num = b, .level_gpio_num = a};
    pcnt_channel_handle_t on_a;
    pcnt_channel_handle_t on_b;

    ESP_ERROR_CHECK(pcnt_new_unit(&unit, &units[side]));
    ESP_ERROR_CHECK(pcnt_unit_set_glitch_filter(units[side], &filter));
    ESP_ERROR_CHECK(pcnt_new_channel(units[side], &of_a, &on_a));
    ESP_ERROR_CHECK(pcnt_new_channel(units[side], &of_b, &on_b));
    ESP_ERROR_CHECK(pcnt_channel_set_edge_action(on_a, PCNT_CHANNEL_EDGE_ACTION_DECREASE, PCNT_CHANNEL_EDGE_ACTION_INCREASE));
    ESP_ERROR_CHECK(pcnt_channel_set_level_action(on_a, PCNT_CHANNEL_LEVEL_ACTION_KEEP, PCNT_CHANNEL_LEVEL_ACTION_INVERSE));
    ESP_ERROR_CHECK(pcnt_channel_set_edge_action(on_b, PCNT_CHANNEL_EDGE_ACTION_INCREASE, PCNT_CHANNEL_EDGE_ACTION_DECREASE));
    ESP_ERROR_CHECK(pcnt_channel_set_level_action(on_b, PCNT_CHANNEL_LEVEL_ACTION_KEEP, PCNT_CHANNEL_LEVEL_ACTION_INVERSE));
    ESP_ERROR_CHECK(gpio_pullup_en(a));
    ESP_ERROR_CHECK(gpio_pullup_en(b));
    ESP_ERROR_CHECK(pcnt_unit_enable(units[side]));
    ESP_ERROR_CHECK(pcnt_unit_clear_count(units[side]));
    ESP_ERROR_CHECK(pcnt_unit_start(units[side]));
}

int32_t board_encoder(enum board_side side)
{
    static int before[2];
    static uint32_t total[2];
    int now = before[side];

    (void)pcnt_unit_get_count(units[side], &now);
    int turned = now - before[side];
    turned += turned > LIMIT / 2 ? -LIMIT : turned < -LIMIT / 2 ? LIMIT : 0;
    before[side] = now;
    total[side] += (uint32_t)turned;
    return (int32_t)total[side];
}

/* --- Line. --- */

#ifdef CONFIG_ROBOFLEET_UDP
static struct udp udp;

_Static_assert(sizeof CONFIG_ROBOFLEET_WIFI_SSID - 1u >= 1u && sizeof CONFIG_ROBOFLEET_WIFI_SSID - 1u <= 32u,
    "name of the Wi-Fi: 1 to 32 characters, in idf.py menuconfig");
_Static_assert(sizeof CONFIG_ROBOFLEET_WIFI_PASSWORD - 1u >= 8u && sizeof CONFIG_ROBOFLEET_WIFI_PASSWORD - 1u <= 63u,
    "password of the Wi-Fi: 8 to 63 characters, in idf.py menuconfig");

static void on_wifi(void *argument, esp_event_base_t base, int32_t event, void *data)
{
    (void)argument;
    (void)base;
    (void)data;
    if (event == WIFI_EVENT_STA_START || event == WIFI_EVENT_STA_DISCONNECTED) {
        (void)esp_wifi_connect();
    }
}

static void start_line(void)
{
    const wifi_init_config_t init = WIFI_INIT_CONFIG_DEFAULT();
    wifi_config_t wifi = {0};

    memcpy(wifi.sta.ssid, CONFIG_ROBOFLEET_WIFI_SSID, sizeof CONFIG_ROBOFLEET_WIFI_SSID - 1u);
    memcpy(wifi.sta.password, CONFIG_ROBOFLEET_WIFI_PASSWORD, sizeof CONFIG_ROBOFLEET_WIFI_PASSWORD - 1u);
    wifi.sta.threshold.authmode = WIFI_AUTH_WPA2_PSK; /* an open network is no network of robots */
    ESP_ERROR_CHECK(esp_netif_init());
    ESP_ERROR_CHECK(esp_event_loop_create_default());
    esp_netif_t *const network = esp_netif_create_default_wifi_sta();
    ESP_ERROR_CHECK(esp_netif_set_hostname(network, CONFIG_ROBOFLEET_HOSTNAME));
    ESP_ERROR_CHECK(esp_wifi_init(&init));
    ESP_ERROR_CHECK(esp_event_handler_register(WIFI_EVENT, ESP_EVENT_ANY_ID, on_wifi, NULL));
    ESP_ERROR_CHECK(esp_wifi_set_storage(WIFI_STORAGE_RAM));
    ESP_ERROR_CHECK(esp_wifi_set_mode(WIFI_MODE_STA));
    ESP_ERROR_CHECK(esp_wifi_set_config(WIFI_IF_STA, &wifi));
    ESP_ERROR_CHECK(esp_wifi_start());
    ESP_ERROR_CHECK(esp_wifi_set_ps(WIFI_PS_NONE)); /* a radio that sleeps hears 0.1 s late */
    if (!udp_open(&udp, 0u, CONFIG_ROBOFLEET_UDP_PORT)) {
        esp_restart();
    }
}

bool board_uart_read(uint8_t *byte)
{
    static uint8_t bytes[UDP_BYTES];
    static uint8_t length;
    static uint8_t at;

    if (at == length) {
        length = udp_receive(&udp, bytes, board_now_us());
        at = 0u;
    }
    if (at == length) {
        return false;
    }
    *byte = bytes[at];
    at++;
    return true;
}

bool board_uart_write(const uint8_t *bytes, uint8_t length)
{
    udp_send(&udp, bytes, length, board_now_us());
    return true;
}
#else
static void start_line(void)
{
    const uart_config_t line = {.baud_rate = RFP_BAUD, .data_bits = UART_DATA_8_BITS, .parity = UART_PARITY_DISABLE,
        .stop_bits = UART_STOP_BITS_1, .flow_ctrl = UART_HW_FLOWCTRL_DISABLE, .source_clk = UART_SCLK_DEFAULT};

    ESP_ERROR_CHECK(uart_driver_install(UART_NUM_0, LINE_BUFFER, LINE_BUFFER, 0, NULL, 0));
    ESP_ERROR_CHECK(uart_param_config(UART_NUM_0, &line));
}

bool board_uart_read(uint8_t *byte)
{
    return uart_read_bytes(UART_NUM_0, byte, 1u, 0u) == 1;
}

bool board_uart_write(const uint8_t *bytes, uint8_t length)
{
    size_t room = 0u;

    return uart_get_tx_buffer_free_size(UART_NUM_0, &room) == ESP_OK && room >= length
           && uart_write_bytes(UART_NUM_0, bytes, length) == length;
}
#endif

/* --- Memory: a partition of its own. Flash stops both cores: a word for 0.1 ms, a block that is erased for 45 ms. --- */

enum { BLOCK_BYTES = 4096 };
static const esp_partition_t *partition;
static uint32_t erased_from;
static uint32_t bytes_to_erase;

bool flash_busy(void) /* the watchdog lives from block to block */
{
    if (bytes_to_erase == 0u) {
        return false;
    }
    bytes_to_erase -= BLOCK_BYTES;
    (void)esp_partition_erase_range(partition, erased_from + bytes_to_erase, BLOCK_BYTES);
    return true;
}

uint32_t flash_read(uint32_t offset)
{
    uint32_t value = 0u; /* which is not whole */

    (void)esp_partition_read(partition, offset, &value, sizeof value);
    return value;
}

void flash_program(uint32_t offset, const uint32_t *words, uint32_t count)
{
    (void)esp_partition_write(partition, offset, words, count * sizeof *words);
}

void flash_erase(uint32_t offset)
{
    erased_from = offset;
    bytes_to_erase = FLASH_SECTOR_BYTES;
}

static void start_memory(void)
{
    partition = esp_partition_find_first(ESP_PARTITION_TYPE_DATA, ESP_PARTITION_SUBTYPE_ANY, "latch");
    if (partition == NULL || partition->size < 2u * FLASH_SECTOR_BYTES) {
        abort(); /* flashed without partitions.csv: without a memory no wheel turns */
    }
    flash_log_start();
}

/* --- Clock, watchdog, reset. --- */

uint32_t board_now_us(void)
{
    return (uint32_t)esp_timer_get_time();
}

void board_watchdog_kick(void)
{
    (void)esp_task_wdt_reset();
}

/* From the watchdog's interrupt, before the reset. */
void esp_task_wdt_isr_user_handler(void);
void IRAM_ATTR esp_task_wdt_isr_user_handler(void)
{
    (void)gpio_set_level(ENABLE, 0);
}

uint8_t board_reset_cause(void)
{
    switch (esp_reset_reason()) {
    case ESP_RST_POWERON: /* its button, too */
        return RESET_POWER_ON;
    case ESP_RST_EXT:
        return RESET_EXTERNAL;
    case ESP_RST_BROWNOUT:
        return RESET_BROWN_OUT;
    case ESP_RST_PANIC:
    case ESP_RST_INT_WDT:
    case ESP_RST_TASK_WDT:
    case ESP_RST_WDT:
        return RESET_WATCHDOG;
    default:
        return 0u;
    }
}

/* --- What this wiring does not have. --- */

uint8_t board_faults(void)
{
    return 0u;
}

uint16_t board_battery_mv(void)
{
    return 0u;
}

int16_t board_current_ma(enum board_side side)
{
    (void)side;
    return 0;
}

static void run(void *argument)
{
    static struct robot robot;
    const esp_task_wdt_config_t watchdog = {.timeout_ms = WATCHDOG_MS, .idle_core_mask = 0u, .trigger_panic = true};

    (void)argument;
    ESP_ERROR_CHECK(esp_task_wdt_init(&watchdog));
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
    robot_start(&robot);
    ESP_ERROR_CHECK(gpio_set_level(ENABLE, 1));
    for (;;) {
        robot_loop(&robot);
        vTaskDelay(1u);
    }
}

void app_main(void)
{
    start_motors();
    start_encoder(BOARD_LEFT, LEFT_A, LEFT_B);
    start_encoder(BOARD_RIGHT, RIGHT_A, RIGHT_B);
    start_memory();
    start_line();
    (void)xTaskCreatePinnedToCore(run, "robot", STACK_BYTES, NULL, PRIORITY, NULL, portNUM_PROCESSORS - 1);
}
