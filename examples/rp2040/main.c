/* An array of 16 x 16 LEDs behind chained shift registers, driven by an RP2040.
 *
 * DMA carries the bytes of patterns.h to the PIO without end; the PIO (slots.pio) keeps the time. The processor only
 * watches: should a byte come too late, the array goes dark instead of showing a slot for too long.
 */
#include "hardware/clocks.h"
#include "hardware/dma.h"
#include "hardware/gpio.h"
#include "hardware/pio.h"
#include "pico/stdlib.h"

#include "patterns.h"
#include "slots.pio.h"

#define PIN_DATA 2u  /* SER of the first register */
#define PIN_CLOCK 3u /* SRCLK of all registers; PIN_CLOCK + 1 is their RCLK */
#define PIN_DARK 5u  /* OE of all registers, with 10 kOhm to their supply: high is dark, also before this program runs */

#define SYSTEM_KHZ 125000u

#if HELIOGRAPH_SIDE != 16
#error "slots.pio counts 256 bits: change its counters and CYCLES for another array"
#endif

/* A whole number of system cycles makes a PIO cycle, so that no slot is longer than another. */
#define PIO_CYCLES_PER_MS (1000u * slots_CYCLES)
#if (SYSTEM_KHZ / 1000u * HELIOGRAPH_SLOT_NS) % PIO_CYCLES_PER_MS || HELIOGRAPH_SLOT_NS < 25000
#error "the slot is no multiple of 25 us: choose another SYSTEM_KHZ, or other delays and CYCLES in slots.pio"
#endif
#define DIVIDER (SYSTEM_KHZ / 1000u * HELIOGRAPH_SLOT_NS / PIO_CYCLES_PER_MS)

static const uint8_t *const first_byte = heliograph_slots;

/* Let DMA send all bytes to the state machine, over and over. */
static void send_without_end(PIO pio, uint machine) {
    uint data = (uint)dma_claim_unused_channel(true);
    uint again = (uint)dma_claim_unused_channel(true);

    /* A byte written to the FIFO is seen in all four bytes of its word, so also in the upper one, which goes out. */
    dma_channel_config c = dma_channel_get_default_config(data);
    channel_config_set_transfer_data_size(&c, DMA_SIZE_8);
    channel_config_set_read_increment(&c, true);
    channel_config_set_write_increment(&c, false);
    channel_config_set_dreq(&c, pio_get_dreq(pio, machine, true));
    channel_config_set_high_priority(&c, true);
    channel_config_set_chain_to(&c, again);
    dma_channel_configure(data, &c, &pio->txf[machine], heliograph_slots, sizeof heliograph_slots, false);

    /* After the last byte: the first one's address, which starts the channel again. */
    c = dma_channel_get_default_config(again);
    channel_config_set_transfer_data_size(&c, DMA_SIZE_32);
    channel_config_set_read_increment(&c, false);
    channel_config_set_write_increment(&c, false);
    channel_config_set_high_priority(&c, true);
    dma_channel_configure(again, &c, &dma_hw->ch[data].al3_read_addr_trig, &first_byte, 1, false);

    dma_channel_start(data);
}

/* Set the state machine up, not yet running. */
static void prepare(PIO pio, uint machine) {
    uint offset = (uint)pio_add_program(pio, &slots_program);
    pio_sm_config c = slots_program_get_default_config(offset);

    sm_config_set_out_pins(&c, PIN_DATA, 1);
    sm_config_set_sideset_pins(&c, PIN_CLOCK);
    sm_config_set_out_shift(&c, false, true, 8); /* the most significant bit first, a new byte after each 8 bits */
    sm_config_set_fifo_join(&c, PIO_FIFO_JOIN_TX);
    sm_config_set_clkdiv_int_frac(&c, DIVIDER, 0);
    for (uint pin = PIN_DATA; pin <= PIN_CLOCK + 1; pin++)
        pio_gpio_init(pio, pin);
    pio_sm_set_consecutive_pindirs(pio, machine, PIN_DATA, 3, true);
    pio_sm_init(pio, machine, offset, &c);
}

int main(void) {
    gpio_init(PIN_DARK);
    gpio_put(PIN_DARK, true);
    gpio_set_dir(PIN_DARK, GPIO_OUT);
    set_sys_clock_khz(SYSTEM_KHZ, true);

    PIO pio = pio0;
    uint machine = (uint)pio_claim_unused_sm(pio, true);
    uint32_t late = 1u << (PIO_FDEBUG_TXSTALL_LSB + machine);

    prepare(pio, machine);
    send_without_end(pio, machine);
    while (!pio_sm_is_tx_fifo_full(pio, machine))
        tight_loop_contents();
    pio->fdebug = late; /* writing a 1 clears it */
    pio_sm_set_enabled(pio, machine, true);

    sleep_us(2 * HELIOGRAPH_SLOT_NS / 1000u); /* the registers hold a slot now, no longer what they woke up with */
    gpio_put(PIN_DARK, false);
    while (!(pio->fdebug & late))
        tight_loop_contents();
    gpio_put(PIN_DARK, true);
    for (;;)
        tight_loop_contents();
}
