"""A YAML loader for users' files, which refuses duplicate keys and too many aliases."""

import yaml

_MOST_COPIED = 1_000_000  # Real files with aliases are about a thousand times smaller.


class OneOfEachKey(yaml.SafeLoader):
    """YAML loader that refuses duplicate keys, of which PyYAML would use only the last.

    It also refuses aliases that would fill the memory: ten lines of ten aliases each represent ten
    billion values. PyYAML does not copy these values, but a check of the values visits each one.
    """

    def get_single_node(self) -> yaml.Node | None:
        node: yaml.Node | None = super().get_single_node()
        if node is not None:
            _refuse_bomb(node)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        keys = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in keys:
                why = f"{key.value} is given twice"
                raise yaml.constructor.ConstructorError(None, None, why, key.start_mark)
            keys.add(key.value)
        return super().construct_mapping(node, deep)


def _refuse_bomb(root: yaml.Node) -> None:
    """Refuse a document whose aliases expand to too many values, or that contains itself.

    A value's size is 1 plus its characters plus the sizes of values in it. With aliases, the size
    of the whole is larger than the sum over all nodes, in which each node counts once.
    """
    size: dict[int, int] = {}
    open_: set[int] = set()
    once = 0

    def refuse(why: str, node: yaml.Node) -> None:
        raise yaml.composer.ComposerError(None, None, why, node.start_mark)

    def measure(node: yaml.Node) -> int:
        nonlocal once
        key = id(node)
        if key in open_:
            refuse("an alias stands inside of what it repeats", node)
        if key not in size:
            open_.add(key)
            is_scalar = isinstance(node, yaml.ScalarNode)
            inner = () if is_scalar else node.value
            own = 1 + (len(node.value) if is_scalar else 0)
            size[key] = own + sum(
                measure(item[0]) + measure(item[1]) if isinstance(item, tuple) else measure(item)
                for item in inner
            )
            open_.remove(key)
            once += own
            if size[key] - once > _MOST_COPIED:
                refuse(f"its aliases stand for more than {_MOST_COPIED:,} characters", node)
        return size[key]

    measure(root)
