// A number, or a truth, for each part: hands and face. PART_COUNT: how many there are, two to four.
#if PART_COUNT == 2
#define PartNumbers vec2
#define PartTruths bvec2
#define EACH_PART(DO, SAMPLE) DO(SAMPLE, 0) DO(SAMPLE, 1)
#elif PART_COUNT == 3
#define PartNumbers vec3
#define PartTruths bvec3
#define EACH_PART(DO, SAMPLE) DO(SAMPLE, 0) DO(SAMPLE, 1) DO(SAMPLE, 2)
#else
#define PartNumbers vec4
#define PartTruths bvec4
#define EACH_PART(DO, SAMPLE) DO(SAMPLE, 0) DO(SAMPLE, 1) DO(SAMPLE, 2) DO(SAMPLE, 3)
#endif

float least(PartNumbers values) {
    float found = values[0];
    for (int k = 1; k < PART_COUNT; ++k) found = min(found, values[k]);
    return found;
}
