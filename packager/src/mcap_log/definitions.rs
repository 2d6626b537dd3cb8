//! The ROS 2 interface definitions that the logs carry so that readers need no ROS installation.

/// An interface: its full name and its fields in the ROS 2 interface definition language.
struct Interface {
    name: &'static str,
    fields: &'static str,
    /// Interfaces that the fields mention, directly or not.
    needs: &'static [&'static str],
}

const INTERFACES: [Interface; 16] = [
    Interface {
        name: "trajectory_msgs/msg/JointTrajectory",
        fields: "std_msgs/Header header\nstring[] joint_names\n\
                 trajectory_msgs/JointTrajectoryPoint[] points\n",
        needs: &[
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "trajectory_msgs/msg/JointTrajectoryPoint",
            "builtin_interfaces/msg/Duration",
        ],
    },
    Interface {
        name: "trajectory_msgs/msg/JointTrajectoryPoint",
        fields: "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\n\
                 float64[] effort\nbuiltin_interfaces/Duration time_from_start\n",
        needs: &[],
    },
    Interface {
        name: "builtin_interfaces/msg/Duration",
        fields: "int32 sec\nuint32 nanosec\n",
        needs: &[],
    },
    Interface {
        name: "sensor_msgs/msg/CompressedImage",
        fields: "std_msgs/Header header\nstring format\nuint8[] data\n",
        needs: HEADER,
    },
    Interface {
        name: "sensor_msgs/msg/Image",
        fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n\
                 uint8 is_bigendian\nuint32 step\nuint8[] data\n",
        needs: HEADER,
    },
    Interface {
        name: "sensor_msgs/msg/CameraInfo",
        fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n\
                 float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\n\
                 uint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
        needs: &[
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "sensor_msgs/msg/RegionOfInterest",
        ],
    },
    Interface {
        name: "sensor_msgs/msg/RegionOfInterest",
        fields: "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
        needs: &[],
    },
    Interface {
        name: "sensor_msgs/msg/PointCloud2",
        fields: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n\
                 bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        needs: &[
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "sensor_msgs/msg/PointField",
        ],
    },
    Interface {
        name: "sensor_msgs/msg/PointField",
        fields: "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n\
                 uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\n\
                 string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
        needs: &[],
    },
    Interface {
        name: "sensor_msgs/msg/JointState",
        fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        needs: HEADER,
    },
    Interface {
        name: "tf2_msgs/msg/TFMessage",
        fields: "geometry_msgs/TransformStamped[] transforms\n",
        needs: &[
            "geometry_msgs/msg/TransformStamped",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "geometry_msgs/msg/Transform",
            "geometry_msgs/msg/Vector3",
            "geometry_msgs/msg/Quaternion",
        ],
    },
    Interface {
        name: "geometry_msgs/msg/TransformStamped",
        fields: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        needs: &[],
    },
    Interface {
        name: "geometry_msgs/msg/Transform",
        fields: "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        needs: &[],
    },
    Interface {
        name: "geometry_msgs/msg/Vector3",
        fields: "float64 x\nfloat64 y\nfloat64 z\n",
        needs: &[],
    },
    Interface {
        name: "geometry_msgs/msg/Quaternion",
        fields: "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
        needs: &[],
    },
    Interface {
        name: "std_msgs/msg/Header",
        fields: "builtin_interfaces/Time stamp\nstring frame_id\n",
        needs: &[],
    },
];

const HEADER: &[&str] = &["std_msgs/msg/Header", "builtin_interfaces/msg/Time"];

const TIME: Interface = Interface {
    name: "builtin_interfaces/msg/Time",
    fields: "int32 sec\nuint32 nanosec\n",
    needs: &[],
};

fn interface(name: &str) -> &'static Interface {
    let found = INTERFACES.iter().chain([&TIME]).find(|i| i.name == name);
    found.expect("only interfaces of this table are asked for")
}

/// The definition of `name` followed by those it needs, in the form of MCAP's `ros2msg` encoding.
pub(crate) fn ros2msg(name: &str) -> String {
    let main = interface(name);
    let mut text = main.fields.to_owned();
    for needed in main.needs.iter().map(|n| interface(n)) {
        text.push_str(&"=".repeat(80));
        text.push_str(&format!("\nMSG: {}\n{}", needed.name.replace("/msg/", "/"), needed.fields));
    }
    text
}
