"""A service that is told to stop stops, whatever a library does with a cancellation."""

import asyncio

from thermojoint.live.cancelling import cancelled
from thermojoint.live.publisher import Publisher
from thermojoint.live.writers import mqtt


async def deaf(times):
    """A work that loses some cancellations, as `asyncio.wait_for` before Python 3.12 may."""
    while True:
        try:
            await asyncio.sleep(60.0)
        except asyncio.CancelledError:
            times -= 1
            if times < 0:
                raise


async def failing():
    raise OSError("gone")


def test_a_task_that_loses_a_cancellation_is_cancelled_again():
    async def live():
        tasks = [asyncio.create_task(one) for one in (deaf(0), deaf(2), failing())]
        await asyncio.sleep(0.0)
        return await asyncio.wait_for(cancelled(*tasks, again=0.01), 10.0)

    first, second, third = asyncio.run(live())
    assert isinstance(first, asyncio.CancelledError)
    assert isinstance(second, asyncio.CancelledError)
    assert isinstance(third, OSError)


def test_what_has_ended_is_not_waited_for():
    async def live():
        done = asyncio.create_task(asyncio.sleep(0.0, "done"))
        await done
        return await cancelled(done), await cancelled()

    assert asyncio.run(live()) == (["done"], [])


def test_a_writer_that_is_cancelled_leaves_no_task():
    async def live():
        watch = asyncio.get_running_loop().create_future()
        writing = asyncio.create_task(mqtt._publish(Publisher(), None, "mill", watch))
        for _ in range(3):
            await asyncio.sleep(0)
        await cancelled(writing)
        await asyncio.sleep(0)
        return asyncio.all_tasks() - {asyncio.current_task()}

    assert asyncio.run(live()) == set()
