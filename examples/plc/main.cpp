// Moves the load of the rotary crane by a line, 1 ms a cycle, and prints M_b, F and M_w of every hundredth one.
#include <cstdio>

#include "feedforward.hpp"

int main()
{
    static Feedforward feedforward;
    Feedforward::Path path{};
    const double from[] = {5.0, 0.0, -5.0}, to[] = {-2.0, 2.0, -2.0}, duration = 20.0, h = 1e-3;
    // 1 - (1 - u)^5 (1 + 5u + 15u^2 + 35u^3 + 70u^4): the polynomial of degree nine of `rest_to_rest`
    const double law[] = {0, 0, 0, 0, 0, 126, -420, 540, -315, 70};
    for (int cycle = 0; cycle <= 20000; cycle++) {
        const double u = cycle * h / duration;
        double scale = 1.0;
        for (int order = 0; order < 5; order++) {
            double value = 0.0;
            for (int j = 9; j >= order; j--) {
                double falling = 1.0;
                for (int i = 0; i < order; i++) falling *= j - i;
                value = value * u + falling * law[j];
            }
            for (int c = 0; c < 3; c++)
                path[3 * order + c] = (order == 0 ? from[c] : 0.0) + (to[c] - from[c]) * value / scale;
            scale *= duration;
        }
        if (!feedforward.update(path, h)) return feedforward.result;
        const auto &found = feedforward.outputs;
        if (cycle % 100 == 0) std::printf("%.17g %.17g %.17g\n", found[0], found[1], found[2]);
    }
    return 0;
}
