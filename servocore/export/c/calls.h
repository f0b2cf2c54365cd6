/* Calls that FMI 2 and FMI 3 have alike. The source of each version includes this file, with OF_FMI(name) for a name of its
   own, and STATE(before, after) and DESERIALIZE for those of saved states, which both versions spell differently. */

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
