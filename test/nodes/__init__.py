import pytest

pytest.register_assert_rewrite('test.nodes.runs', 'test.nodes.fault_rounds')
