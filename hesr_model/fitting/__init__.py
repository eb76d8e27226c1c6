"""From friction records to a frozen law."""
