/* Calls that FMI 2 and FMI 3 have alike. The source of each version includes this file, with OF_FMI(name) for a name of its
   own, and further macros for what both versions spell differently: STATE(before, after) and DESERIALIZE for calls of saved
   states, NUMBERS(what) and ITEMS(what) for those of variables, and NUMBER, SETTABLE and ITEM for their types in sentences.
   FMI 3 has arrays: VALUES(type) are values with their count, ROOM is this count. */

#define REQUIRE(phases, call) \
    Instance *instance = (Instance *)component; \
    if (refused(instance, phases, call)) return OF_FMI(Error)
#define NAME_OF(call) NAME_OF_EXPANDED(call)
#define NAME_OF_EXPANDED(call) #call
#define REQUIRE_INSTANCE REQUIRE(ANY, "") /* no phase is refused, and without an instance there is no logger */

void OF_FMI(FreeInstance)(void *component) { free_instance((Instance *)component); }

OF_FMI(Status) OF_FMI(SetDebugLogging)(void *component, OF_FMI(Boolean) on, size_t count, const OF_FMI(String) categories[])
{
    REQUIRE_INSTANCE;
    return STATUS[set_logging(instance, on ? 1 : 0, count, categories)];
}

OF_FMI(Status) OF_FMI(Terminate)(void *component)
{
    REQUIRE(AFTER, "fmi_Terminate");
    return STATUS[ended(instance)];
}

OF_FMI(Status) OF_FMI(Reset)(void *component)
{
    REQUIRE_INSTANCE;
    reset(instance);
    return STATUS[GOOD];
}

/* States ------------------------------------------------------------------------------------------------------------- */

OF_FMI(Status) STATE(Get, )(void *component, void **saved)
{
    REQUIRE_INSTANCE;
    return STATUS[keep_state(instance, &instance->state, saved)];
}

OF_FMI(Status) STATE(Set, )(void *component, void *saved)
{
    REQUIRE_INSTANCE;
    return STATUS[restore_state(instance, saved)];
}

OF_FMI(Status) STATE(Free, )(void *component, void **saved)
{
    free_state((Instance *)component, saved);
    return STATUS[GOOD];
}

OF_FMI(Status) STATE(Serialized, Size)(void *component, void *saved, size_t *size)
{
    (void)component;
    (void)saved;
    *size = sizeof(State);
    return STATUS[GOOD];
}

OF_FMI(Status) STATE(Serialize, )(void *component, void *saved, OF_FMI(Byte) bytes[], size_t size)
{
    REQUIRE_INSTANCE;
    return STATUS[write_state(instance, saved, bytes, size)];
}

OF_FMI(Status) DESERIALIZE(void *component, const OF_FMI(Byte) bytes[], size_t size, void **saved)
{
    REQUIRE_INSTANCE;
    return STATUS[read_state(instance, bytes, size, saved)];
}

/* Variables ---------------------------------------------------------------------------------------------------------- */

/* A host whose setters cannot fail may set values after the end. */
#define SETTING (DEFERRED_CHECKS ? ANY : BEFORE | DURING | AFTER)

static Outcome unknown_reference(const Instance *instance, OF_FMI(ValueReference) reference, const char *type)
{
    return say(instance, ERROR, "no %s variable has the value reference %u" IGNORED, type, reference);
}

static Outcome wrong_count(const Instance *instance, size_t count)
{
    return say(instance, ERROR, "%u values do not fit the sizes of the variables", (unsigned)count);
}

OF_FMI(Status) NUMBERS(Get)(void *component, const OF_FMI(ValueReference) references[], size_t count, VALUES(double))
{
    Outcome worst = GOOD;
    const size_t room = ROOM;
    size_t done = 0;
    REQUIRE(ANY, NAME_OF(NUMBERS(Get)));
    for (size_t k = 0; k < count; k++) {
        const Array array = array_of(references[k]);
        Outcome outcome;
        if (array.first == NOWHERE)
            outcome = unknown_reference(instance, references[k], NUMBER);
        else if (array.size > room - done)
            return STATUS[wrong_count(instance, room)];
        else
            outcome = get_numbers(instance, array.first, array.size, values + done);
        if (outcome != GOOD && STOPS) return STATUS[outcome];
        if (array.first == NOWHERE) values[done] = NAN;
        if (outcome > worst) worst = outcome;
        done += array.size;
    }
    return STATUS[done == room ? worst : wrong_count(instance, room)];
}

/* What is refused is left as it was. */
OF_FMI(Status) NUMBERS(Set)(void *component, const OF_FMI(ValueReference) references[], size_t count, VALUES(const double))
{
    Outcome worst = GOOD;
    const size_t room = ROOM;
    size_t done = 0;
    REQUIRE(SETTING, NAME_OF(NUMBERS(Set)));
    for (size_t k = 0; k < count; k++) {
        const Array array = array_of(references[k]);
        const int known = array.first < N_NUMBERS;
        if (known && array.size > room - done) return STATUS[wrong_count(instance, room)];
        for (size_t i = 0; i < array.size; i++) {
            const Outcome outcome = known ? set_number(instance, array.first + i, values[done + i])
                                          : unknown_reference(instance, references[k], SETTABLE);
            if (outcome != GOOD && STOPS) return STATUS[outcome];
            if (outcome > worst) worst = outcome;
        }
        done += array.size;
    }
    return STATUS[done == room ? worst : wrong_count(instance, room)];
}

/* Enumerations are integers. */
OF_FMI(Status) ITEMS(Get)(void *component, const OF_FMI(ValueReference) references[], size_t count, VALUES(Integer))
{
    Outcome worst = GOOD;
    const size_t room = ROOM;
    REQUIRE(ANY, NAME_OF(ITEMS(Get)));
    if (room != count) return STATUS[wrong_count(instance, room)];
    for (size_t k = 0; k < count && !(STOPS && worst != GOOD); k++) {
        const size_t choice = (size_t)references[k] - FIRST_CHOICE;
        if (choice < N_CHOICES)
            values[k] = (Integer)instance->state.choices[choice];
        else
            worst = unknown_reference(instance, references[k], ITEM);
    }
    return STATUS[worst];
}

OF_FMI(Status) ITEMS(Set)(void *component, const OF_FMI(ValueReference) references[], size_t count, VALUES(const Integer))
{
    Outcome worst = GOOD;
    const size_t room = ROOM;
    REQUIRE(SETTING, NAME_OF(ITEMS(Set)));
    if (room != count) return STATUS[wrong_count(instance, room)];
    for (size_t k = 0; k < count && !(STOPS && worst != GOOD); k++) {
        const size_t choice = (size_t)references[k] - FIRST_CHOICE;
        const Outcome outcome = choice < N_CHOICES ? set_choice(instance, choice, values[k])
                                                   : unknown_reference(instance, references[k], ITEM);
        if (outcome > worst) worst = outcome;
    }
    return STATUS[worst];
}

#define NO_SUCH_CALL(what, type, value_type) \
    OF_FMI(Status) OF_FMI(what##type)(void *component, const OF_FMI(ValueReference) references[], size_t count, \
                                      VALUES(value_type)) \
    { \
        const size_t room = ROOM; \
        REQUIRE(ANY, NAME_OF(OF_FMI(what##type))); \
        (void)values; \
        (void)room; \
        return STATUS[count == 0 ? GOOD : unknown_reference(instance, references[0], #type)]; \
    }
#define NO_SUCH_VARIABLES(type) NO_SUCH_CALL(Get, type, OF_FMI(type)) NO_SUCH_CALL(Set, type, const OF_FMI(type))
NO_SUCH_VARIABLES(Boolean)
NO_SUCH_VARIABLES(String)

/* Write the places of all components of variables one after the other; returns whether they are `size` places, or says
   why not. */
static int spread(const Instance *instance, const OF_FMI(ValueReference) references[], size_t count, size_t size,
                  size_t places[])
{
    size_t found = 0;
    for (size_t k = 0; k < count; k++) {
        const Array array = array_of(references[k]);
        if (array.first >= N_NUMBERS) {
            unknown_reference(instance, references[k], NUMBER);
            return 0;
        }
        if (found + array.size > N_NUMBERS) {
            say(instance, ERROR, "more unknowns or knowns than the %d numbers were requested", N_NUMBERS);
            return 0;
        }
        for (size_t i = 0; i < array.size; i++) places[found++] = array.first + i;
    }
    if (found != size) wrong_count(instance, size);
    return found == size;
}
