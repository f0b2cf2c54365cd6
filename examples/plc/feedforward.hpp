// The inverse model of the rotary crane as a class, around the C source of `servocore export rotary_crane --c source`.
// It neither allocates nor throws; an object may be static or a member of a task.
#pragma once

#include <array>

#include "rotary_crane.h"

class Feedforward {
public:
    using Path = std::array<double, ROTARY_CRANE_PATH>;              // position to snap of the load, order by order
    using Outputs = std::array<double, ROTARY_CRANE_OUTPUTS>;        // M_b, F, M_w first
    using Parameters = std::array<double, ROTARY_CRANE_PARAMETERS>;  // in SI units

    Feedforward() noexcept
    {
        for (int k = 0; k < ROTARY_CRANE_PARAMETERS; k++) parameters[k] = rotary_crane_defaults[k];
    }

    // One cycle: begin at the first call, go on by h seconds at the others. False: outputs are those of the last good call.
    bool update(const Path &path, double h) noexcept
    {
        Outputs found;
        result = begun ? rotary_crane_step(&memory, path.data(), h, parameters.data(), found.data())
                       : rotary_crane_start(&memory, path.data(), parameters.data(), found.data());
        if (result != ROTARY_CRANE_OK) return false;
        begun = true;
        outputs = found;
        return true;
    }

    void reset() noexcept { begun = false; }

    Parameters parameters;
    Outputs outputs{};
    int result = ROTARY_CRANE_OK;  // why the last call failed, see rotary_crane.h

private:
    rotary_crane_memory memory{};
    bool begun = false;
};
