/* Counts instructions of the exported controller on an emulated Cortex-M4F (QEMU mps2-an386 with -icount shift=0: the
 * virtual clock advances by 1 ns an instruction, SysTick by one every 40 ns). Prints through semihosting. */
#include "vpptwin.h"

#define REGISTER(address) (*(volatile unsigned int *)(address))
#define TICK_INSTRUCTIONS 40u
#define REPEAT 200

extern unsigned int data_load, data_start, data_end, bss_start, bss_end, stack_top;
int main(void);
void reset(void);
void stop(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)stop, (const void *)stop, (const void *)stop, (const void *)stop,
    (const void *)stop,
};

static int semihost(int what, const void *with)
{
    register int r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = with;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void stop(void)
{
    semihost(0x18, (const void *)0x20026);
    for (;;) {
    }
}

void reset(void)
{
    unsigned int *from = &data_load, *to = &data_start;
    REGISTER(0xE000ED88) |= 0xFu << 20; /* floating-point unit on */
    __asm__ volatile("dsb\n isb");
    while (to < &data_end) *to++ = *from++;
    for (to = &bss_start; to < &bss_end; to++) *to = 0;
    main();
    stop();
}

static void print_number(const char *name, unsigned int value)
{
    char text[48];
    int n = 0, digits = 1;
    unsigned int rest = value;
    while (*name) text[n++] = *name++;
    text[n++] = ' ';
    while (rest /= 10) digits++;
    for (int i = digits - 1; i >= 0; i--, value /= 10) text[n + i] = (char)('0' + value % 10);
    n += digits;
    text[n++] = '\n';
    text[n] = 0;
    semihost(0x04, text);
}

static unsigned int read_clock(void) { return 0xFFFFFFu - REGISTER(0xE000E018); }

static vpptwin_state state;

int main(void)
{
    static float thrust, rate, pitch[2], throttle[2];
    const float pose[3] = {0.1f, 1.2f, 0.3f}, velocity[3] = {0.2f, -0.1f, 1.0f}, target[3] = {0.0f, 1.25f, 0.0f};
    const float speed[2] = {470.0f, 472.0f};
    unsigned int began, wrong;
    REGISTER(0xE000E014) = 0xFFFFFF; /* SysTick: reload, clear, run from the processor's clock */
    REGISTER(0xE000E018) = 0;
    REGISTER(0xE000E010) = 5;
    wrong = (unsigned int)vpptwin_start(&state, 0);
    print_number("failed", wrong);
    began = read_clock();
    for (int i = 0; i < REPEAT; i++) {
        __asm__ volatile("" ::: "memory");
        vpptwin_policy(&state, pose, velocity, target, &thrust, &rate);
    }
    print_number("policy", (read_clock() - began) * TICK_INSTRUCTIONS / REPEAT);
    for (int adaptive = 0; adaptive < 2; adaptive++) {
        vpptwin_start(&state, adaptive);
        began = read_clock();
        for (int i = 0; i < REPEAT; i++) {
            const float current[2] = {5.0f + 0.01f * (float)i, 5.1f - 0.01f * (float)i};
            __asm__ volatile("" ::: "memory");
            vpptwin_cascade(&state, thrust, rate, 0.9f, speed, current, pitch, throttle);
        }
        print_number(adaptive ? "cascade_adaptive" : "cascade_map", (read_clock() - began) * TICK_INSTRUCTIONS / REPEAT);
    }
    return 0;
}
