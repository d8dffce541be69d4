// How body, hands and face become one field: the rule of avatarrex/fields/composition.py, part after part. Metres.
#include "lib/parts.glsl"

const float BAND_LOW = -0.05, BAND_HIGH = 0.025;  // open interval of a part's distance in which it is blended (eq. 13)
const float NOWHERE = 1e9;

struct Composition {
    float own;      // min over parts of the blend of part and own body
    float others;   // max over parts of the other limbs' body field
    float bound;    // how far a ray may step as far as the terms go
    float winners;  // parts that tie for `own`
    PartNumbers weight;  // their effective omega
};

Composition compose_nothing() { return Composition(NOWHERE, -NOWHERE, NOWHERE, 0, PartNumbers(0)); }

bool in_band(float part_sdf) { return part_sdf > BAND_LOW && part_sdf < BAND_HIGH; }

// Part k holds the point: `part` = (s_k, omega), `body` = (own, others).
void compose_part(inout Composition sum, int k, vec2 part, vec2 body) {
    float omega = in_band(part.x) ? part.y : 0;
    float c = omega == 0 ? body.x : omega * part.x + (1 - omega) * body.x;
    if (c < sum.own) {
        sum.weight = PartNumbers(0);
        sum.winners = 0;
    }
    if (c <= sum.own) {
        sum.weight[k] = omega;
        sum.winners += 1;
    }
    sum.own = min(sum.own, c);
    sum.others = max(sum.others, body.y);
    sum.bound = min(sum.bound, min(abs(part.x), min(abs(body.x), abs(body.y))));
}

bool compose_any(Composition sum) { return sum.winners > 0; }

float compose_sdf(Composition sum, float body) { return compose_any(sum) ? min(sum.own, sum.others) : body; }

// Inside boxes min(|s|, |own|, |s_k|, |others|), in none |s|.
float compose_step(Composition sum, float sdf) { return min(abs(sdf), sum.bound); }

PartNumbers compose_weight(Composition sum) {
    return sum.others < sum.own ? PartNumbers(0) : sum.weight / max(sum.winners, 1);
}
