// The light on a floor under figures, as `FloorLight` (avatarrex/surface/floor.py) has it. Reads the key light's map of heights
// and spheres that stand for the figures (surface/spheres.py); writes shares of key light and sky. World frame about the map's corner, metres.
in vec2 v_uv;

uniform sampler2D u_cast;      // least height over the floor of each ray, NOTHING where none
uniform vec2 u_size;           // of the map, metres along x and z
uniform mat2 u_penumbra;       // offset on the floor for each metre of height and a unit of the light's disc
uniform int u_count;
uniform vec4 u_spheres[MOST_SPHERES];  // centre, with y over the floor and x, z from the map's corner; radius

layout(location = 0) out vec2 out_light;

float height_at(vec2 place) { return textureLod(u_cast, place / u_size, 0).x; }

vec2 turned(int k, float turn) {
    float a = 2.39996323 * k + turn;
    return vec2(cos(a), sin(a));
}

float key_light(vec2 place, float turn) {
    float sum = 0, count = 0;
    for (int k = 0; k < TAPS; ++k) {  // dense about the middle, where what is low throws its shadow
        float r = TALLEST * k * k / ((TAPS - 1.0) * (TAPS - 1.0));
        float height = height_at(place + r * (u_penumbra * turned(k, turn)));
        if (height < TALLEST && height >= r - 0.03) { sum += height; count += 1; }
    }
    if (count == 0) return 1.0;
    float radius = max(sum / count, 0.02), dark = 0;
    for (int k = 0; k < TAPS; ++k)
        dark += float(height_at(place + radius * sqrt((k + 0.5) / TAPS) * (u_penumbra * turned(k, turn))) < TALLEST);
    return 1 - dark / TAPS;
}

float sky_light(vec2 place) {
    float free = 1;
    for (int k = 0; k < u_count; ++k) {
        vec4 sphere = u_spheres[k];
        vec3 to = vec3(sphere.x - place.x, sphere.y, sphere.z - place.y);
        float d2 = dot(to, to);
        free *= 1 - min(1.0, sphere.w * sphere.w * max(sphere.y, 0.0) * inversesqrt(d2) / d2);
    }
    return free;
}

void main() {
    vec2 place = v_uv * u_size;
    ivec2 cell = ivec2(gl_FragCoord.xy) & 1;
    float turn = 0.6 * (cell.x + 2 * cell.y);  // soften.frag takes it away
    out_light = vec2(key_light(place, turn), sky_light(place));
}
