"""`ros2 launch plumb.launch.py [config:=plumb.toml]`: Plumb, in the graph that this is launched in."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    config = DeclareLaunchArgument("config", default_value=str(Path(__file__).with_name("plumb.toml")))
    plumb = ExecuteProcess(cmd=["plumb", "serve", "--config", LaunchConfiguration("config")], output="screen")
    return LaunchDescription([config, plumb])
