#include <NAME.h>

static NAME_state state;

void setup() {
    Serial.begin(115200);
    NAME_init(&state);
}

void loop() {
    NUMBER input = 0; /* what is wanted next */
    NUMBER output = NAME_step(&state, input);
    Serial.println(output);
}
