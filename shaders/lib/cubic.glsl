// Where the cubic through f(0), f(1/3), f(2/3), f(1) has its minimum; negative where it has none.
float cubic_minimum(vec4 f) {
    float c1 = dot(f, vec4(-5.5, 9, -4.5, 1));
    float c2 = dot(f, vec4(9, -22.5, 18, -4.5));
    float c3 = dot(f, vec4(-4.5, 13.5, -13.5, 4.5));
    float root = c2 * c2 - 3 * c1 * c3;
    if (root < 0) return -1;
    root = sqrt(root);
    // The root of c1 + 2 c2 u + 3 c3 u^2 with positive curvature, without cancellation.
    float u = c2 > 0 ? -c1 / (c2 + root) : (root - c2) / (3 * c3);
    return u >= 0 && u <= 1 ? u : -1;
}
